/* The interrupt that counts, and how others look at what it has counted. */
#include "flow.h"

static volatile uint32_t pulses;

#ifdef __AVR__
#include <avr/interrupt.h>
#include <util/atomic.h>

/* At PD2, where a falling edge is a pulse. */
ISR(INT0_vect) {
    pulses++;
}

/* Four bytes are four loads here: without ATOMIC_BLOCK the interrupt may come in between. */
uint32_t pulses_total(void) {
    uint32_t now = 0;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        now = pulses;
    }
    return now;
}

void pulses_start(void) {
    PORTD |= _BV(2);
    EICRA = _BV(ISC01);
    EIMSK = _BV(INT0);
}

#else

/* One load where an int has 32 bits. */
uint32_t pulses_total(void) {
    return pulses;
}

#ifdef __unix__
#include "on_this_machine.h"

/* The interrupt of a process is a signal. */
static void pulse(int number) {
    (void)number;
    pulses++;
}

void pulses_start(void) {
    each_millisecond(pulse);
}
#else
void pulses_start(void) {
    /* not wired on this board */
}
#endif
#endif
