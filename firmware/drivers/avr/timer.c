/* See timer.h. */
#include "timer.h"

#include <avr/interrupt.h>
#include <avr/io.h>
#include <util/atomic.h>

#if F_CPU % 64000 || F_CPU / 64000 > 256
#error "F_CPU must be a multiple of 64 kHz up to 16.384 MHz, so that timer 0 can count milliseconds"
#endif

static struct {
    uint16_t period_ms, left_ms;
    void (*callback)(void);
} timers[TIMER_COUNT];

/* Other interrupts may come in between, above all the receiver's, but not this one again: where others take all
 * the time, it would pile up on the stack. So it switches itself off before it lets them in, and the registers
 * are saved only then. */
ISR(TIMER0_COMPA_vect, ISR_NAKED) {
    __asm__ volatile("push r24\n\t"
                     "ldi r24, 0\n\t"
                     "sts %0, r24\n\t"
                     "pop r24\n\t"
                     "sei\n\t"
                     "jmp __vector_timer0_rest" ::"n"(_SFR_MEM_ADDR(TIMSK0)));
}

void __vector_timer0_rest(void) __attribute__((signal, used, externally_visible));
void __vector_timer0_rest(void) {
    uint8_t i;
    for (i = 0; i < TIMER_COUNT; i++) {
        if (timers[i].period_ms && --timers[i].left_ms == 0) {
            timers[i].left_ms = timers[i].period_ms;
            timers[i].callback();
        }
    }
    cli();
    TIMSK0 = _BV(OCIE0A);
}

void timer_init(void) {
    TCCR0A = _BV(WGM01);            /* from 0 to OCR0A */
    TCCR0B = _BV(CS01) | _BV(CS00); /* F_CPU / 64 */
    OCR0A = F_CPU / 64000 - 1;
    TCNT0 = 0;
    TIFR0 = _BV(OCF0A);
    TIMSK0 = _BV(OCIE0A);
}

void timer_start(uint8_t timer, uint16_t period_ms, void (*callback)(void)) {
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        timers[timer].period_ms = period_ms;
        timers[timer].left_ms = period_ms;
        timers[timer].callback = callback;
    }
}
