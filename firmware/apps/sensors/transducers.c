/* See transducers.h. */
#include "transducers.h"

#include "j2a.h"
#include "ticks.h"

/* A turn of the main loop is longest while it sends the longest reply, 518 bytes on the wire, after a SIF. */
#if BAUD < 57600
#error "BAUD: the times of samples need 57600 or more"
#endif
enum { OLD_TICKS = 0x6000 };

void sample_take(sample *s) {
    bool fresh;
    uint16_t tick;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        fresh = s->fresh;
        s->fresh = false;
        s->taken = s->value;
        tick = s->tick;
    }
    if (fresh) {
        s->time_us = ticks_time_us(j2a_port_time_us(), tick);
        s->changed = true;
    }
}

bool sample_changed(sample *s) {
    bool changed;
    sample_take(s);
    changed = s->changed;
    s->changed = false;
    return changed;
}

void sample_watch(sample *s) {
    uint16_t age;
    bool fresh;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        age = (uint16_t)(j2a_port_ticks() - s->tick);
        fresh = s->fresh;
    }
    if (fresh && age >= OLD_TICKS)
        sample_take(s);
}

void sample_write(const sample *s, uint16_t value, uint8_t *to) {
    j2a_put_u32(to, (uint32_t)s->time_us);
    j2a_put_u32(to + 4, (uint32_t)(s->time_us >> 32));
    to[8] = (uint8_t)value;
    to[9] = (uint8_t)(value >> 8);
}
