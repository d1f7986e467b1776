/* See quad.h. */
#include "quad.h"

#include <avr/interrupt.h>
#include <stddef.h>
#include <util/atomic.h>
#include <util/delay.h>

#include "pins.h"
#include "quadrature.h"
#include "triggered.h"

static int16_t values[QUAD_COUNT];
static uint16_t misses[QUAD_COUNT];
static uint8_t levels; /* of the last interrupt: two bits for each encoder */
static void (*callback)(uint8_t channel, int16_t value);
static void (*misses_callback)(uint8_t channel, uint16_t value);

void quad_set_cb(void (*new_value)(uint8_t channel, int16_t value)) {
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        callback = new_value;
    }
}

void quad_misses_set_cb(void (*new_value)(uint8_t channel, uint16_t value)) {
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        misses_callback = new_value;
    }
}

static inline uint8_t read_levels(void) {
    return (uint8_t)(QUAD_IN >> QUAD_SHIFT) & 0x0f;
}

/* Made for each channel anew, because constant addresses are faster. */
static inline __attribute__((always_inline)) void step(uint8_t channel, uint8_t before, uint8_t now) {
    const int8_t steps = quadrature_step(before, now);
    if (steps == QUADRATURE_ILLEGAL) {
        const uint16_t count = misses[channel] + 1;
        if (count) {
            misses[channel] = count;
            if (misses_callback)
                misses_callback(channel, count);
        }
    } else {
        const int16_t value = values[channel] + steps;
        values[channel] = value;
        if (callback && !IS_TRIGGERED(quad))
            callback(channel, value);
    }
}

/* For all four wires. It reads the levels once, so what changes later interrupts again. */
ISR(QUAD_vect) {
    const uint8_t before = levels;
    const uint8_t now = read_levels();
    const uint8_t changed = before ^ now;
    levels = now;
    if (changed & 0x03)
        step(0, before & 3, now & 3);
    if (changed & 0x0c)
        step(1, before >> 2, now >> 2);
}

void quad_init(void) {
    if (QUAD_MASK & (0x0f << QUAD_SHIFT))
        return; /* it is for both, quad and quad_misses */
    QUAD_OUT |= 0x0f << QUAD_SHIFT;
    _delay_us(QUAD_RISE_US);
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        QUAD_MASK |= 0x0f << QUAD_SHIFT;
        PCIFR = _BV(QUAD_ENABLE);
        levels = read_levels(); /* after the flag is clear: what changes from now on interrupts */
        PCICR |= _BV(QUAD_ENABLE);
    }
}

void quad_task(void) {
}

void quad_misses_init(void) {
    quad_init();
}

void quad_misses_task(void) {
}

void quad_trigger(void) {
    int16_t latched[QUAD_COUNT];
    uint8_t channel;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        for (channel = 0; channel < QUAD_COUNT; channel++)
            latched[channel] = values[channel];
    }
    for (channel = 0; channel < QUAD_COUNT; channel++)
        if (callback)
            callback(channel, latched[channel]);
}

int16_t quad_get(uint8_t channel) {
    int16_t value;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        value = values[channel];
    }
    return value;
}

void quad_set(uint8_t channel, int16_t value) {
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        values[channel] = value;
        if (callback && !IS_TRIGGERED(quad))
            callback(channel, value);
    }
}
