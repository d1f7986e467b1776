/* Timer 1 of an AVR as the clock of a port, for chips that have TIMSK1. In: F_CPU. Out: j2a_port_ticks() and
 * j2a_port_time_us(), which avr_clock.c implements.
 * Rule: timer 1 belongs to this clock; it runs freely at F_CPU / AVR_CLOCK_DIVIDER and interrupts each 65536 ticks. */
#ifndef AVR_CLOCK_H
#define AVR_CLOCK_H

#include <stdint.h>

/* The ticks of timer 1 are cheaper to note than microseconds. Those of a clock that is disciplined say no time yet.
 * Here, because the core says what holds for ports that say nothing. */
#if defined J2A_WITH_SYNC && J2A_WITH_SYNC
#define J2A_PORT_STAMP 0
#else
#define J2A_PORT_STAMP 1
#endif

#include "j2a_options.h"

/* Of the processor's clock. A clock that is disciplined has a tick of 0.5 us at 16 MHz. */
#if defined J2A_WITH_SYNC && J2A_WITH_SYNC /* the options may come later, and then it is 0 */
#define AVR_CLOCK_DIVIDER 8
#else
#define AVR_CLOCK_DIVIDER 64
#endif

/* For J2A_TICKS_PER_MS: rounded up. */
#define AVR_CLOCK_TICKS_PER_MS ((F_CPU + AVR_CLOCK_DIVIDER * 1000UL - 1) / (AVR_CLOCK_DIVIDER * 1000UL))

/* The overflows of timer 1, see avr_clock.c; with interrupts off. */
#if !defined J2A_WITH_CLOCK || J2A_WITH_CLOCK
extern uint32_t avr_clock_overflows;
#endif

/* The clock waits by this timer, see j2a_clock.h. A port may hold interrupts back that would delay what is done at the
 * end of the wait: by AVR_CLOCK_QUIET(due) in its j2a_port_config.h, which is called with interrupts off. due: the end
 * of the wait, in ticks of timer 1. */
#define J2A_PORT_WAIT (J2A_WITH_SYNC && F_CPU % 8000000 == 0)

/* Chips that do not multiply do what the clock multiplies by a product of their own, see j2a_clock.h. */
#ifdef __AVR_HAVE_MUL__
#define J2A_PORT_PRODUCT 0
#else
#define J2A_PORT_PRODUCT J2A_WITH_SYNC
#endif

/* Starts it; called once. */
void avr_clock_start(void);

#endif
