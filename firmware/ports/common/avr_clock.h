/* Timer 1 of an AVR as the clock of a port, for chips that have TIMSK1. In: F_CPU. Out: j2a_port_ticks() and
 * j2a_port_time_us(), which avr_clock.c implements.
 * Rule: timer 1 belongs to this clock; it runs freely at F_CPU / 64 and interrupts each 65536 ticks. */
#ifndef AVR_CLOCK_H
#define AVR_CLOCK_H

/* For J2A_TICKS_PER_MS: rounded up. */
#define AVR_CLOCK_TICKS_PER_MS ((F_CPU + 63999) / 64000)

/* Starts it; called once. */
void avr_clock_start(void);

#endif
