/* The port on top of Stream, millis() and micros(). Bytes flow from the stream into the parser, and from the
 * sender into the stream.
 * Rule: a Stream does not say that it lost bytes, but one that was never full has lost none. So whenever one
 * with a known size is found full, what it holds is still good, and what comes behind it is dropped until
 * the stream is empty and the parser knows of the loss; bytes from before and after it never end up in one
 * frame. */
#include "J2A.h"

J2ADevice J2A;

namespace {

struct Link {
    Stream *stream;
    uint16_t holds; /* full when so many bytes wait; 0: not known */
    uint16_t good;  /* after a loss: bytes that are from before it */
    uint16_t overruns;
    bool lost;
#if J2A_TXBUF
    uint8_t tx[J2A_TXBUF];
    uint16_t used;
#endif
};

Link links[J2A_LINKS];

enum { BYTES_IN_A_ROW = 255 }; /* then loop() goes on, also when bytes come without end */

/* Drops what waits. Has all of it been dropped? */
bool drop(Stream &stream) {
    uint8_t i;
    for (i = 0; i < BYTES_IN_A_ROW; i++)
        if (stream.read() < 0)
            return true;
    return false;
}

void flush(Link &link) {
#if J2A_TXBUF
    if (link.used != 0)
        link.stream->write(link.tx, link.used); /* what it does not take, because nobody listens, is lost */
    link.used = 0;
#else
    (void)link;
#endif
}

#if J2A_WITH_CLOCK
/* What stands above the 32 bits of micros(). The lowest bit of each byte repeats the highest one below, of the next byte
 * or of micros(); where it does not, that one has wrapped, and the byte is one behind. So whoever looks, in an interrupt
 * or in loop(), gets the same from what it reads, whatever comes in between, if it reads the highest byte first. */
enum { ABOVE = 3 }; /* 53 bits are 285 years */
volatile uint8_t above[ABOVE];

uint64_t note_time() {
    uint8_t bytes[ABOVE];
    uint8_t i, half;
    uint32_t now_us, high = 0;

    for (i = ABOVE; i-- != 0;)
        bytes[i] = above[i];
    now_us = micros();
    half = static_cast<uint8_t>(now_us >> 31);
    for (i = 0; i < ABOVE; i++) {
        if ((bytes[i] & 1) != half)
            above[i] = ++bytes[i];
        high |= static_cast<uint32_t>(bytes[i] >> 1) << 7 * i;
        half = bytes[i] >> 7;
    }
    return static_cast<uint64_t>(high) << 32 | now_us;
}
#endif

} // namespace

void j2a_port_init(int, char **) {
}

int16_t j2a_port_rx(void) {
    Link &link = links[j2a_link];
    uint16_t waiting;

    if (link.stream == nullptr)
        return -1;
    if (link.holds == 0)
        return static_cast<int16_t>(link.stream->read());
    waiting = static_cast<uint16_t>(link.stream->available());
    if (!link.lost && waiting >= link.holds) {
        link.lost = true;
        link.good = waiting;
    }
    if (link.lost) {
        if (link.good != 0) {
            link.good--;
        } else if (drop(*link.stream)) {
            j2a_rx_lost();
            link.overruns++;
            link.lost = false;
            return -1;
        } else {
            return -1;
        }
    }
    return static_cast<int16_t>(link.stream->read());
}

void j2a_port_tx(uint8_t byte) {
    Link &link = links[j2a_link];
    if (link.stream == nullptr)
        return;
#if J2A_TXBUF
    link.tx[link.used++] = byte;
    if (link.used == J2A_TXBUF)
        flush(link);
#else
    link.stream->write(byte);
#endif
}

uint16_t j2a_port_ticks(void) {
    return static_cast<uint16_t>(millis());
}

#if J2A_WITH_CLOCK
uint64_t j2a_port_time_us(void) {
    return note_time();
}
#endif

uint16_t j2a_port_overruns(void) {
    return links[j2a_link].overruns;
}

void j2a_port_idle(void) {
    for (Link &link : links)
        flush(link);
#if J2A_WITH_CLOCK
    note_time(); /* at least every 35 minutes, and the sketch may look at the clock less often */
#endif
}

void J2ADevice::serve(uint8_t link, Stream &stream, uint16_t holds) {
    if (link >= J2A_LINKS)
        return;
    links[link].stream = &stream;
    links[link].holds = holds;
}

void J2ADevice::task() {
    j2a_task();
    j2a_port_idle();
}

#if J2A_WITH_SIF
void J2ADevice::sendSif(uint8_t opcode, const void *payload, uint8_t length) {
    j2a_send_sif(opcode, length, static_cast<const uint8_t *>(payload));
}
#endif

void J2ADevice::debug(const char *text) {
    j2a_debug(text);
}

uint16_t J2ADevice::overruns() {
    return j2a_port_overruns();
}
