/* See sharp.h. */
#include "sharp.h"

#if SHARP_MODEL == SHARP_GP2Y0A02YK
enum { COUNTS_AT_INFINITY = 0, SHIFT_MM = 70 };
#define SCALE 144200ul
#else
enum { COUNTS_AT_INFINITY = 12, SHIFT_MM = 29 };
#define SCALE 58790ul
#endif

uint16_t sharp_mm(uint16_t counts) {
    uint16_t above, mm;
    if (counts <= COUNTS_AT_INFINITY + (SCALE >> 16)) /* with fewer, mm would not fit into 16 bits */
        return SHARP_OUT_OF_RANGE;
    above = (uint16_t)(counts - COUNTS_AT_INFINITY);
    mm = (uint16_t)(((uint32_t)SCALE + above / 2) / above); /* rounded */
    if (mm < SHARP_NEAREST_MM + SHIFT_MM || mm > SHARP_FARTHEST_MM + SHIFT_MM)
        return SHARP_OUT_OF_RANGE;
    return (uint16_t)(mm - SHIFT_MM);
}
