/* A port on top of a board's few functions (board.h). Nothing is to be filled in here.
 * Bytes flow from the UART into a ring, and from there into the parser; to the UART they flow at once.
 * With BOARD_INTERRUPTS 0 whatever waits also receives; a function that computes for longer than the
 * UART's own buffer lasts loses bytes, which is noticed. With 1 the receive interrupt fills the ring.
 * Rules: the producer (port_receive) writes only `head`, the consumer (j2a_port_rx) only `tail`, so
 * neither needs a lock. After a loss nothing is stored until the ring is empty and the parser knows
 * of the loss, so that bytes from before and after it never end up in one frame. */
#include "board.h"
#include "j2a_port.h"

/* Both sides must read an index in one step: on a chip of 8 bits keep J2A_RXBUF below 256. */
#if J2A_RXBUF < 256
typedef uint8_t ring_index;
#else
typedef uint16_t ring_index;
#endif
#if J2A_RXBUF > 65535
#error "J2A_RXBUF must be 1..65535"
#endif
#if J2A_TXBUF > 0
#error "this port has no transmit buffer, so J2A_TXBUF must be 0; what a board collects itself is up to its board.c"
#endif

enum { MAX_BYTES_PER_POLL = 32 }; /* so that endless input cannot block the main loop */

typedef struct {
    volatile uint8_t bytes[J2A_RXBUF + 1u]; /* one place stays free, so that full and empty differ */
    volatile ring_index head, tail;
    volatile bool lost;
    uint16_t overruns;
} ring_of_link;
static ring_of_link rings[J2A_LINKS];
#define ring (rings[j2a_link])

static ring_index after(ring_index index) {
    return index == J2A_RXBUF ? 0 : (ring_index)(index + 1);
}

/* Takes one byte from the UART into the ring. */
#if !BOARD_INTERRUPTS
static
#endif
void port_receive(void) {
    const bool lost_before = board_lost();
    const uint8_t byte = board_read();

    if (!ring.lost) {
        const ring_index next = after(ring.head);
        if (lost_before || next == ring.tail) {
            ring.lost = true;
        } else {
            ring.bytes[ring.head] = byte;
            ring.head = next;
        }
    }
}

#if J2A_LINKS > 1
#if !BOARD_INTERRUPTS
#error "J2A_LINKS of more than 1 needs BOARD_INTERRUPTS 1: while one link sends, the others receive"
#endif
void port_receive_from(uint8_t link) {
    const uint8_t served = j2a_link;
    j2a_link = link;
    port_receive();
    j2a_link = served;
}
#endif

/* While the ring is full bytes stay where they are: a pipe makes the host wait, a UART loses them and
 * says so. A driver's interrupt that looks at the clock comes here, too: not while the main loop is here. */
static void poll_receiver(void) {
#if !BOARD_INTERRUPTS
    uint8_t i;
#if J2A_WITH_CLOCK
    static volatile bool is_inside;
    if (is_inside)
        return;
    is_inside = true;
#endif
    for (i = 0; i < MAX_BYTES_PER_POLL && after(ring.head) != ring.tail && board_has_byte(); i++)
        port_receive();
#if J2A_WITH_CLOCK
    is_inside = false;
#endif
#endif
}

void j2a_port_init(int argc, char **argv) {
    (void)argc;
    (void)argv;
    board_init();
}

int16_t j2a_port_rx(void) {
    bool after_loss;
    poll_receiver();
    /* Read before the ring is looked at: once it is set the ring gets no more, so "empty" stays true. */
    after_loss = ring.lost;
    if (ring.tail != ring.head) {
        const uint8_t byte = ring.bytes[ring.tail];
        ring.tail = after(ring.tail);
        return byte;
    }
    if (after_loss) {
        j2a_rx_lost();
        ring.overruns++;
        ring.lost = false;
    }
    return -1;
}

void j2a_port_tx(uint8_t byte) {
    while (!board_can_write())
        poll_receiver();
    board_write(byte);
    poll_receiver();
}

#if BOARD_MICROSECONDS
/* Here only the lower half counts, which wraps after 71 minutes; the main loop turns more often. No division of
 * 64 bits, which takes long. */
uint16_t j2a_port_ticks(void) {
    static uint32_t counted_us;
    static uint16_t ms;
    const uint32_t more_ms = ((uint32_t)board_us() - counted_us) / 1000;
    counted_us += more_ms * 1000;
    ms = (uint16_t)(ms + more_ms);
    return ms;
}
#else
uint16_t j2a_port_ticks(void) {
    return (uint16_t)board_ms();
}
#endif

#if J2A_WITH_CLOCK
#if BOARD_MICROSECONDS
#define time_us board_us
#else
/* What stands above the 32 bits of board_ms(). The lowest bit of each byte repeats the highest one below, of the byte
 * before or of board_ms(); where it does not, that one has wrapped, and the byte is one behind. So whoever looks, in an
 * interrupt or interrupted, writes the same bytes. Read from the top, so that none is newer than what is below it. */
#define ABOVE 3
static volatile uint8_t above[ABOVE];

static uint64_t time_us(void) {
    uint8_t bytes[ABOVE];
    uint32_t high = 0;
    uint32_t now_ms;
    uint8_t half;
    uint8_t i;

    for (i = ABOVE; i-- != 0;)
        bytes[i] = above[i];
    now_ms = board_ms();
    half = (uint8_t)(now_ms >> 31);
    for (i = 0; i < ABOVE; i++) {
        if ((bytes[i] & 1) != half)
            above[i] = ++bytes[i];
        high |= (uint32_t)(bytes[i] >> 1) << 7 * i;
        half = bytes[i] >> 7;
    }
    return ((uint64_t)high << 32 | now_ms) * 1000;
}
#endif

uint64_t j2a_port_time_us(void) {
    poll_receiver(); /* a function that waits looks at the clock */
    return time_us();
}
#endif

uint16_t j2a_port_overruns(void) {
    return ring.overruns;
}

/* A board may sleep, so it is not asked to while something waits: each request would wait for a sleep to end. */
void j2a_port_idle(void) {
    uint8_t link;
    poll_receiver();
    for (link = 0; link < J2A_LINKS; link++) {
        if (rings[link].head != rings[link].tail || rings[link].lost)
            return;
    }
    board_idle();
}
