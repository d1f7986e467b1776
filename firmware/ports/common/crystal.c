/* See crystal.h. The wander is a triangle over time. */
#include "crystal.h"

#include <stdbool.h>
#include <stdlib.h>

#define PERIOD_S 64
#define PERIOD_US (PERIOD_S * 1000000ULL)

static double ppm_of(const char *name) {
    const char *const text = getenv(name);
    const double ppm = text ? strtod(text, NULL) : 0;
    return ppm > -1e6 && ppm < 1e9 ? ppm : 0;
}

uint64_t crystal_us(uint64_t true_us) {
    static bool is_known;
    static double drift, wander;
    /* The part of a period that passed, and what the triangle has gathered in it: a quarter up and half down. */
    const double part = (double)(true_us % PERIOD_US) / (double)PERIOD_US;
    const double gathered = part < 0.5 ? part * (0.5 - part) * 2 : (part - 0.5) * (part - 1) * 2;
    if (!is_known) {
        drift = ppm_of("J2A_DRIFT_PPM");
        wander = ppm_of("J2A_WANDER_PPM");
        is_known = true;
    }
    return true_us + (uint64_t)(int64_t)((double)true_us * drift / 1000000 + gathered * wander * PERIOD_S);
}
