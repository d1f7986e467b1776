/* Periodic calls. In: a period and a function. Out: the function called, each time that the period is over.
 * Timer 0 counts milliseconds, exactly: each is F_CPU / 1000 cycles, so a period has no drift.
 * Rules: the callback runs in the interrupt, with other interrupts on. It may take up to a millisecond,
 * together with the others that are due then; what is longer belongs to the main loop. */
#ifndef TIMER_H
#define TIMER_H

#include <stdint.h>

#ifndef TIMER_COUNT
#define TIMER_COUNT 4
#endif

void timer_init(void);

/* Calls the function each `period_ms`, from now on; 0 stops. timer: 0..TIMER_COUNT-1, whose former function is
 * forgotten. */
void timer_start(uint8_t timer, uint16_t period_ms, void (*callback)(void));

#endif
