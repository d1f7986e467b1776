/* See servo.h. */
#include "servo.h"

#include <avr/interrupt.h>
#include <util/atomic.h>

#include "pins.h"
#include "ticks.h"

#define PERIOD TICKS_OF_US(SERVO_PERIOD_US)

static uint16_t widths[SERVO_COUNT]; /* ticks of the pulses; 0: none */
static uint16_t highs[SERVO_COUNT];  /* ticks of the pulse that is on the pin; 0: none */

/* After an edge: chooses what the next one is, and when. COM1x1 connects the pin; COM1x0 says that it goes
 * high. */
#define PREPARE(channel, compare, rise)                          \
    do {                                                         \
        const uint16_t high = highs[channel];                    \
        if (high) { /* it has just ended */                      \
            highs[channel] = 0;                                  \
            compare += PERIOD - high;                            \
            if (widths[channel])                                 \
                TCCR1A |= rise;                                  \
        } else if (TCCR1A & (rise)) {                            \
            highs[channel] = widths[channel];                    \
            compare += widths[channel];                          \
            TCCR1A &= (uint8_t)~(rise);                          \
        } else {                                                 \
            compare += PERIOD;                                   \
            if (widths[channel])                                 \
                TCCR1A |= rise;                                  \
        }                                                        \
    } while (0)

ISR(TIMER1_COMPA_vect) {
    PREPARE(0, OCR1A, _BV(COM1A0));
}

ISR(TIMER1_COMPB_vect) {
    PREPARE(1, OCR1B, _BV(COM1B0));
}

void servo_init(void) {
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        const uint16_t start = TCNT1 + PERIOD / 2;
        TCCR1A = _BV(COM1A1) | _BV(COM1B1); /* the next match clears the pin ... */
        TCCR1C = _BV(FOC1A) | _BV(FOC1B);   /* ... and that is now */
        SERVO_DDR |= _BV(SERVO_BIT_A) | _BV(SERVO_BIT_B);
        OCR1A = start;
        OCR1B = start + PERIOD / 2;
        TIFR1 = _BV(OCF1A) | _BV(OCF1B);
        TIMSK1 |= _BV(OCIE1A) | _BV(OCIE1B);
    }
}

void servo_task(void) {
}

void servo_set(uint8_t channel, int8_t deflection) {
    const uint16_t width = ticks_of_servo(deflection);
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        widths[channel] = width;
    }
}
