/* What an app should not do: `blocked` keeps the interrupts off while it sends as many SIFs as its payload says, of
 * 100 bytes each, more than the port has room for. Its reply comes when they have been sent, or were dropped.
 * `deaf` keeps them off for as many milliseconds as its payload says, and does nothing. */
#include <avr/interrupt.h>
#include <util/delay.h>

#include "j2a_functions.h"

enum { SIF_BLOCKED = 5, SIF_SIZE = 100 };

uint8_t blocked(uint8_t *const length, uint8_t **const payload) {
    uint8_t left = **payload;
    cli();
    for (; left != 0; left--)
        j2a_send_sif(SIF_BLOCKED, SIF_SIZE, *payload);
    sei();
    *length = 0;
    return 0;
}

uint8_t deaf(uint8_t *const length, uint8_t **const payload) {
    uint8_t left = **payload;
    cli();
    for (; left != 0; left--)
        _delay_ms(1);
    sei();
    *length = 0;
    return 0;
}

void j2a_app_task(void) {
}
