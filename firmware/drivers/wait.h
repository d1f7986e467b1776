/* Waiting for milliseconds without standing still. A port's ticks have 16 bits, which last for 32 ms only where a
 * tick is 0.5 us, so longer waits count milliseconds. Rule: ask at least once in 65535 ticks, or it lasts longer. */
#ifndef WAIT_H
#define WAIT_H

#include <stdbool.h>

#include "j2a_port.h"

#define WAIT_COUNTS (255UL * J2A_TICKS_PER_MS >= 65536UL)

typedef struct {
    uint16_t since; /* tick */
#if WAIT_COUNTS
    uint8_t ms; /* that are over */
#endif
} wait_t;

static inline void wait_begin(wait_t *wait) {
    wait->since = j2a_port_ticks();
#if WAIT_COUNTS
    wait->ms = 0;
#endif
}

/* Whether so many milliseconds are over, 1 to 255. */
static inline bool wait_is_over(wait_t *wait, uint8_t limit_ms) {
#if WAIT_COUNTS
    while ((uint16_t)(j2a_port_ticks() - wait->since) >= J2A_TICKS_PER_MS) {
        wait->since += (uint16_t)J2A_TICKS_PER_MS;
        if (wait->ms < limit_ms)
            wait->ms++;
    }
    return wait->ms >= limit_ms;
#else
    return (uint16_t)(j2a_port_ticks() - wait->since) >= limit_ms * J2A_TICKS_PER_MS;
#endif
}

#endif
