/* See sharp.h. */
#include "sharp.h"

enum { COUNTS_AT_INFINITY = 12, SHIFT_MM = 29 };
static const uint16_t scale = 58790;

uint16_t sharp_mm(uint16_t counts) {
    uint16_t above, mm;
    if (counts <= COUNTS_AT_INFINITY)
        return SHARP_OUT_OF_RANGE;
    above = (uint16_t)(counts - COUNTS_AT_INFINITY);
    mm = (uint16_t)(((uint32_t)scale + above / 2) / above); /* rounded */
    if (mm < SHARP_NEAREST_MM + SHIFT_MM || mm > SHARP_FARTHEST_MM + SHIFT_MM)
        return SHARP_OUT_OF_RANGE;
    return (uint16_t)(mm - SHIFT_MM);
}
