/* Marks what receiving and answering costs with GPIOR0, for a simulator that counts the cycles between two
 * writes:
 *   mark 8: an echo of J2A_ROOM bytes without escapes passes through a function that does nothing
 *   mark 1: the same through j2a_rx_parse(); the difference is the parser without call and return
 *   mark 2: as mark 1 with every byte of the payload escaped
 *   mark 9: one byte through j2a_rx_parse(): the first is one of a payload, without escape; then come all that
 *           may cost more, in good and in wrong frames
 *   mark 10: one byte through the function that does nothing
 *   mark 5: j2a_process() with an echo without payload, and a transmitter that takes each byte at
 *           once
 *   mark 6: the same with the payload of mark 1
 *   mark 7: the same with the payload of mark 2
 *   mark 3: nothing but the receive interrupts that come meanwhile
 *   mark 4: j2a_poll() with what came in mark 3
 * Out go two echoes, after marks 1 and 2; in the end it answers like any device. */
#include <avr/interrupt.h>
#include <avr/io.h>
#include <string.h>

#include "j2a_internal.h"
#include "usart.h"

#if J2A_TXBUF != 0
#error "with a transmit ring marks 5 to 7 would wait for it: build with TXBUF=0"
#endif

enum { ECHO = 1 + J2A_WITH_MANY + J2A_WITH_PROPERTIES + J2A_WITH_DEBUG };

static uint8_t wire[2 * J2A_ROOM + 10];

void j2a_app_task(void) {
}

static uint8_t *put(uint8_t *next, uint8_t byte) {
    if (byte == J2A_SOF || byte == J2A_SOS || byte == J2A_ESC) {
        *next++ = J2A_ESC;
        byte--;
    }
    *next++ = byte;
    return next;
}

/* An echo of so many times the given value. Returns its length on the wire. */
static uint16_t build(uint8_t seq, uint8_t value, uint8_t length) {
    uint8_t *next = wire;
    uint8_t checksum = (uint8_t)(ECHO + J2A_CHK_OPCODE) ^ (uint8_t)(length + J2A_CHK_LENGTH);
    uint8_t i;
    *next++ = J2A_SOF;
    next = put(next, seq);
    next = put(next, ECHO);
    next = put(next, length);
    for (i = 0; i != length; i++) {
        next = put(next, value);
        checksum ^= value;
    }
    next = put(next, checksum);
    return (uint16_t)(next - wire);
}

/* Takes bytes one by one within a mark, with interrupts off. Called by a pointer, so that the loop
 * is the same for every function that takes the bytes. */
__attribute__((noinline, noclone)) static void feed(uint8_t mark, const uint8_t *byte, uint16_t length,
                                                 void (*take)(uint8_t byte)) {
    cli();
    GPIOR0 = mark;
    for (; length != 0; length--)
        take(*byte++);
    GPIOR0 = 0;
}

__attribute__((noinline, noclone)) static void nothing(uint8_t byte) {
    (void)byte;
    __asm__ volatile("");
}

/* Takes what was built with a mark for each byte. */
static void feed_each(uint16_t length) {
    uint16_t i;
    for (i = 0; i != length; i++)
        feed(9, wire + i, 1, j2a_rx_parse);
}

/* Everything that a byte may be: markers and escapes in each field, a checksum that is escaped or wrong, a wrong
 * escape, and a frame that ends too early. The parser is left as it was. */
static void feed_the_dearest(void) {
    enum { CHECKSUM = (ECHO + J2A_CHK_OPCODE) ^ (1 + J2A_CHK_LENGTH) }; /* of a payload of one byte 0 */
    static const uint8_t long_one[] = {J2A_SOF, 0, ECHO, J2A_ESC, J2A_ESC - 1, 0};
    uint16_t length = build(0, 0x55, 2);
    feed(0, wire, 4, j2a_rx_parse);
    feed(9, wire + 4, 1, j2a_rx_parse);
    feed(10, wire, 1, nothing);
    feed_each(length); /* breaks the one before off */
    feed_each(build(J2A_SOF, J2A_SOF, 3));
    feed_each(length = build(J2A_ESC, CHECKSUM ^ J2A_SOS, 1));
    wire[length - 1] ^= 1;
    feed_each(length);
    wire[length - 1] = 0xFF;
    feed_each(length);
    memcpy(wire, long_one, sizeof(long_one));
    feed_each(sizeof(long_one));
    feed_each(build(0, 0, 0));
    j2a_process();
    sei();
}

/* The reply to what was parsed last, into a transmitter that is off and so never busy. */
#define ANSWER(mark) do { \
    GPIOR0 = mark; \
    j2a_process(); \
    GPIOR0 = 0; \
    sei(); \
} while (0)

int main(void) {
    uint16_t turns;

    j2a_port_init(0, 0);
    TIMSK1 = 0; /* no interrupts but the USART's */

    feed(8, wire, build(0, 0x55, J2A_ROOM), nothing);
    feed(1, wire, build(0, 0x55, J2A_ROOM), j2a_rx_parse);
    sei();
    j2a_process();

    feed(2, wire, build(0, J2A_SOF, J2A_ROOM), j2a_rx_parse);
    sei();
    j2a_process();

    __builtin_avr_delay_cycles(F_CPU / BAUD * 30); /* for the last two characters */
    UCSRnB &= (uint8_t)~_BV(BIT_TXEN);
    feed(0, wire, build(0, 0, 0), j2a_rx_parse);
    ANSWER(5);
    feed(0, wire, build(0, 0x55, J2A_ROOM), j2a_rx_parse);
    ANSWER(6);
    feed(0, wire, build(0, J2A_SOF, J2A_ROOM), j2a_rx_parse);
    ANSWER(7);
    feed_the_dearest();
    UCSRnB |= _BV(BIT_TXEN);

    for (;;) {
        for (turns = 0; turns < 1000; turns++) {
            GPIOR0 = 3;
            __builtin_avr_delay_cycles(100);
            GPIOR0 = 0;
        }
        cli();
        GPIOR0 = 4;
        j2a_poll();
        GPIOR0 = 0;
        sei();
        j2a_process();
    }
}
