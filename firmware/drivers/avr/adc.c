/* See adc.h. Empty on chips without an ADC. */
#include "adc.h"

#include <avr/interrupt.h>
#include <avr/pgmspace.h>
#include <stdbool.h>
#include <stddef.h>
#include <util/atomic.h>

#include "j2a_port.h"
#include "pins.h"
#include "triggered.h"

#ifdef ADC_INPUTS
static const uint8_t PROGMEM inputs[ADC_COUNT] = ADC_INPUTS;
static uint16_t values[ADC_COUNT];
static volatile bool busy;
static volatile uint8_t scans; /* that are over */
static uint8_t channel; /* that is being converted */
static bool is_new;     /* the scan that runs was begun by a trigger */
static bool is_next;    /* another scan follows */
static bool is_asked;   /* by adc_trigger(): the next scan to begin is for the callback ... */
static bool is_told;    /* ... which gets it */
static void (*callback)(uint8_t channel, uint16_t value);

#define CONTROL (_BV(ADEN) | _BV(ADIE) | _BV(ADPS2) | _BV(ADPS1) | _BV(ADPS0)) /* F_CPU / 128 */

static inline void convert(uint8_t which) {
    channel = which;
    ADMUX = _BV(REFS0) | pgm_read_byte(&inputs[which]); /* REFS0: AVCC is the reference */
    ADCSRA = CONTROL | _BV(ADSC);
}

static inline void scan(void) {
    if (IS_TRIGGERED(adc) || IS_TRIGGERED(sharp)) {
        is_new = false;
        is_told = is_asked;
        is_asked = false;
    }
    busy = true;
    convert(0);
}

/* Other interrupts may come in between, above all the receiver's. This one comes again only after the next
 * conversion, which therefore begins last, with interrupts off: so it never piles up on the stack. */
ISR(ADC_vect, ISR_NOBLOCK) {
    const uint8_t done = channel;
    const uint16_t value = ADC;
    values[done] = value;
    if (callback && (!IS_TRIGGERED(adc) || is_told))
        callback(done, value);
    cli();
    if (done + 1 < ADC_COUNT) {
        convert(done + 1);
    } else {
        busy = false;
        scans++;
        if ((IS_TRIGGERED(adc) || IS_TRIGGERED(sharp)) && is_next) {
            is_next = false;
            scan();
        }
    }
}

void adc_init(void) {
    uint8_t i;
    for (i = 0; i < ADC_COUNT; i++) { /* the digital input of an analog pin only takes power */
        const uint8_t input = pgm_read_byte(&inputs[i]);
        if (input < 8)
            DIDR0 |= (uint8_t)_BV(input);
    }
    ADCSRB = 0;
    ADCSRA = CONTROL;
}

void adc_set_cb(void (*new_value)(uint8_t channel, uint16_t value)) {
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        callback = new_value;
    }
}

void adc_task(void) {
    static uint16_t since;
    if (!IS_TRIGGERED(adc) && (uint16_t)(j2a_port_ticks() - since) >= ADC_PERIOD_MS * J2A_TICKS_PER_MS) {
        since = j2a_port_ticks();
        adc_start();
    }
}

void adc_start(void) {
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        if (!busy)
            scan();
    }
}

uint8_t adc_scan(void) {
    uint8_t over;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        over = (uint8_t)(scans + 1);
        if (!busy) {
            scan();
            is_new = true;
        } else if (!is_new || channel != 0) {
            is_next = true;
            over++;
        }
    }
    return over;
}

void adc_trigger(void) {
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        is_asked = true;
        (void)adc_scan();
        if (!is_next) { /* it may have been begun for another sensor, at this time */
            is_told = true;
            is_asked = false;
        }
    }
}

uint8_t adc_scans(void) {
    return scans;
}

uint16_t adc_get(uint8_t channel) {
    uint16_t value;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        value = values[channel];
    }
    return value;
}
#else
typedef int adc_is_missing; /* C has no empty files */
#endif
