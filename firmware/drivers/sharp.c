/* See sharp.h. */
#include "sharp.h"

#ifdef SHARP_MODEL
enum { MODEL = SHARP_MODEL };
#elif defined J2A_WITH_TRANSDUCERS && J2A_WITH_TRANSDUCERS
#include "transds.h"
/* Of each line of transds.def its model if its prefix is sharp, else nothing. */
#define J2A_ENUM(name, integer, ...)
#define J2A_STRUCT(name, ...)
#define J2A_TRANSD(KIND, name, id, prefix, model, ...) J2A_INNER_SECOND(MODEL_IF_##prefix, NO_MODEL)(model)
#define MODEL_IF_sharp ~, MODEL_OF_LINE
#define MODEL_OF_LINE(model) +SHARP_##model
#define NO_MODEL(model)
enum {
    MODEL = 0
#include "j2a_transds_list.h"
};
#else
enum { MODEL = SHARP_GP2Y0A21YK };
#endif

enum { IS_FAR = MODEL == SHARP_GP2Y0A02YK };
enum { NEAREST_MM = IS_FAR ? 190 : 95, FARTHEST_MM = IS_FAR ? 1600 : 850 };
enum { COUNTS_AT_INFINITY = IS_FAR ? 0 : 12, SHIFT_MM = IS_FAR ? 70 : 29 };
#define SCALE (IS_FAR ? 144200ul : 58790ul)

uint16_t sharp_mm(uint16_t counts) {
    uint16_t above, mm;
    if (counts <= COUNTS_AT_INFINITY + (SCALE >> 16)) /* with fewer, mm would not fit into 16 bits */
        return SHARP_OUT_OF_RANGE;
    above = (uint16_t)(counts - COUNTS_AT_INFINITY);
    mm = (uint16_t)(((uint32_t)SCALE + above / 2) / above); /* rounded */
    if (mm < NEAREST_MM + SHIFT_MM || mm > FARTHEST_MM + SHIFT_MM)
        return SHARP_OUT_OF_RANGE;
    return (uint16_t)(mm - SHIFT_MM);
}
