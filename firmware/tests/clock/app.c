/* Reads the clock again and again, at all phases of the timer. Marks with GPIOR0, for a simulator:
 * mark 1 when it went back, or ahead by more than a few readings take; mark 2 about each second.
 * Then it sends a SIF. */
#include <avr/io.h>

#include "j2a.h"

int main(void) {
    uint64_t before_us;
    uint8_t wait = 0;

    /* As a boot loader may leave them: the timer ends at 255, characters have 5 bits. */
    TCCR1A = _BV(WGM10);
    UCSR0C = 0;
    j2a_port_init(0, 0);
    before_us = j2a_port_time_us();
    for (;;) {
        const uint64_t now_us = j2a_port_time_us();
        volatile uint8_t i;
        if (now_us < before_us || now_us - before_us > 100) {
            GPIOR0 = 1;
            GPIOR0 = 0;
        }
        if ((now_us ^ before_us) >> 20) {
            GPIOR0 = 2;
            GPIOR0 = 0;
            j2a_send_sif(2, 0, 0);
        }
        before_us = now_us;
        for (i = wait++ & 15; i != 0; i--) {
        }
    }
}
