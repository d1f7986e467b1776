/* Reads the clock again and again, at all phases of the timer, which it makes count 64 times as fast, so that
 * it wraps often. Marks with GPIOR0, for a simulator: mark 1 when the clock went back, or ahead by more than a
 * few readings take; mark 2 about each second of the clock. Then it sends a SIF. */
#include <avr/io.h>

#include "j2a.h"

int main(void) {
    uint64_t before_us;
    uint64_t last_s = 0;
    uint8_t wait = 0;

    /* As a boot loader may leave them: the timer ends at 255, characters have 5 bits. */
    TCCR1A = _BV(WGM10);
    UCSR0C = 0;
    j2a_port_init(0, 0);
    TCCR1B = _BV(CS10);
    before_us = j2a_port_time_us();
    for (;;) {
        const uint64_t now_us = j2a_port_time_us();
        volatile uint8_t i;
        if (now_us < before_us || now_us - before_us > 64 * 100) {
            GPIOR0 = 1;
            GPIOR0 = 0;
        }
        before_us = now_us;
        if (now_us >> 20 != last_s) {
            last_s = now_us >> 20;
            GPIOR0 = 2;
            GPIOR0 = 0;
            j2a_send_sif(2, 0, 0);
            before_us = j2a_port_time_us(); /* sending took its time */
        }
        for (i = wait++ & 15; i != 0; i--) {
        }
    }
}
