/* Samples on their way from the drivers' callbacks to the host. In: values, given by interrupts. Out: their bytes
 * in a SIF or reply: u64 microseconds of the device's clock at the callback, then the raw value, 2 bytes, all
 * little-endian. A SIF has these for each channel of its transducer, one after the other.
 * Rules: there is no queue, so a value that was not taken out yet makes way for the next one. What is not marked
 * "by interrupts" belongs to the main context. */
#ifndef TRANSDUCERS_H
#define TRANSDUCERS_H

#include <avr/io.h>
#include <stdbool.h>
#include <stdint.h>
#include <util/atomic.h>

#define SENSOR(name, id, prefix, model, channels, type, none) \
    enum { name##_id = id, name##_channels = channels };
#include "transds.def"
#undef SENSOR

enum { SAMPLE_BYTES = 8 + 2 };

typedef struct {
    uint64_t time_us;     /* of the value that was taken out last; 0: none yet */
    uint16_t taken;       /* that value */
    bool changed;         /* since sample_changed() was asked last */
    bool fresh;           /* by interrupts, as the two below: not taken out yet */
    uint16_t value, tick;
} sample;

/* By interrupts: a new value, as of now. In the header, because it should not cost a call there. */
static inline __attribute__((always_inline)) void sample_put(sample *s, uint16_t value) {
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        s->tick = TCNT1; /* as j2a_port_ticks() */
        s->value = value;
        s->fresh = true;
    }
}

/* Takes the newest value out: into `taken`, with its time. */
void sample_take(sample *);

/* Takes it out; returns whether there was a new one since this was last asked. */
bool sample_changed(sample *);

/* Takes it out before it gets so old that its tick no longer tells its time. Called for each sample every 16 ms;
 * or later, up to 100 ms, when the main loop is held up. */
void sample_watch(sample *);

/* Writes SAMPLE_BYTES bytes: the time of the sample, and the value that is given, made of `taken`. */
void sample_write(const sample *, uint16_t value, uint8_t *to);

#endif
