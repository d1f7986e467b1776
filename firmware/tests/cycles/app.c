/* Marks what receiving costs with GPIOR0, for a simulator that counts the cycles between two writes:
 *   mark 1: 255 bytes of payload without escapes pass through j2a_rx_byte(), the loop included
 *   mark 2: the same with every byte of the payload escaped
 *   mark 3: nothing but the receive interrupts that come meanwhile
 *   mark 4: j2a_poll() with what came in mark 3
 * Between the marks it answers like any device. */
#include <avr/interrupt.h>
#include <avr/io.h>

#include "j2a_internal.h"

static uint8_t wire[2 * J2A_MAX_PAYLOAD + 8];

void j2a_app_task(void) {
}

/* An echo of 255 times the given value. Returns its length on the wire. */
static uint16_t build(uint8_t value) {
    const uint8_t head[] = {0, 3, 255}; /* seq, opcode of a2jEcho without debug, length */
    uint8_t *next = wire;
    uint8_t checksum = (0 ^ (3 + J2A_CHK_OPCODE) ^ (uint8_t)(255 + J2A_CHK_LENGTH)) ^ value;
    uint16_t i;
    *next++ = J2A_SOF;
    for (i = 0; i < 3; i++)
        *next++ = head[i];
    for (i = 0; i < 255; i++) {
        if (value == J2A_SOF) {
            *next++ = J2A_ESC;
            *next++ = J2A_SOF - 1;
        } else {
            *next++ = value;
        }
    }
    *next++ = checksum;
    return (uint16_t)(next - wire);
}

int main(void) {
    const uint8_t *byte = wire;
    uint16_t length, i;

    j2a_port_init(0, 0);
    TIMSK1 = 0; /* no interrupts but the USART's */

    length = build(0x55);
    cli();
    GPIOR0 = 1;
    for (i = length; i != 0; i--)
        j2a_rx_parse(*byte++);
    GPIOR0 = 0;
    sei();
    j2a_process();

    length = build(J2A_SOF);
    byte = wire;
    cli();
    GPIOR0 = 2;
    for (i = length; i != 0; i--)
        j2a_rx_parse(*byte++);
    GPIOR0 = 0;
    sei();
    j2a_process();

    for (;;) {
        for (i = 0; i < 5000; i++) {
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
