/* What an app should not do and the core must live with: first it sends a SIF that is longer than the
 * transmit buffer with interrupts off, then it keeps the main loop waiting for as long as a 16-bit timer
 * takes at 2 MHz, in each turn. */
#include <avr/interrupt.h>

#include "j2a.h"

void j2a_app_task(void) {
    static const uint8_t zeros[100];
    static bool sent;
    const uint64_t start_us = j2a_port_time_us();

    if (!sent) {
        cli();
        j2a_send_sif(1, sizeof zeros, zeros);
        sei();
        sent = true;
    }
    while (j2a_port_time_us() - start_us < 32768) {
    }
}
