/* The distance that an analog infrared sensor of Sharp sees, by the model that the line of transds.def names:
 *     GP2Y0A21YK   10 to 80 cm; GP2D12 is its forerunner
 *     GP2Y0A02YK   20 to 150 cm
 * or by the option SHARP_MODEL, such as SHARP_GP2Y0A02YK.
 * In: counts of a 10-bit ADC with 5 V as reference. Out: millimetres, by integer arithmetic, from the hyperbola that
 * triangulation gives, fitted to the typical curve of the data sheet (mm = scale / (counts - infinity) - shift):
 *     GP2Y0A21YK   58790 / (counts - 12) - 29    within 3 %; a count is 1.4 mm at 10 cm and 12 mm at 80 cm
 *     GP2Y0A02YK   144200 / counts - 70          within 6 %; a count is 0.5 mm at 20 cm and 17 mm at 150 cm
 * Single sensors differ from the typical curve by more than that (0.25 to 0.55 V at the far end): for better, measure
 * yours and fit the three numbers. All sensors of a program are of one model.
 * Rule: nearer than about 8 cm (GP2Y0A02YK: 15 cm) the voltage falls again, so an object there looks like a distant one. */
#ifndef SHARP_H
#define SHARP_H

#include <stdint.h>

#define SHARP_GP2Y0A21YK 21
#define SHARP_GP2D12 SHARP_GP2Y0A21YK
#define SHARP_GP2Y0A02YK 2
#if defined SHARP_MODEL && SHARP_MODEL != SHARP_GP2Y0A21YK && SHARP_MODEL != SHARP_GP2Y0A02YK
#error "SHARP_MODEL: SHARP_GP2Y0A21YK or SHARP_GP2Y0A02YK"
#endif

enum { SHARP_OUT_OF_RANGE = 0 };

/* Returns millimetres, or SHARP_OUT_OF_RANGE. Divides: call it from the main context. */
uint16_t sharp_mm(uint16_t counts);

#endif
