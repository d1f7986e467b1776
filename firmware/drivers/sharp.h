/* The distance that an analog infrared sensor sees: Sharp GP2Y0A21YK (GP2D12 is its forerunner), 10 to 80 cm.
 * In: counts of a 10-bit ADC with 5 V as reference. Out: millimetres, by integer arithmetic:
 *     mm = 58790 / (counts - 12) - 29
 * the hyperbola that triangulation gives, fitted to the typical curve of the data sheet, which it follows
 * within 3 %. One count is 1.4 mm at 10 cm and 12 mm at 80 cm. Single sensors differ from the typical curve
 * by more than that (80 cm is 0.25 to 0.55 V): for better, measure yours and fit the three numbers.
 * Rule: nearer than about 8 cm the voltage falls again, so an object there looks like a distant one. */
#ifndef SHARP_H
#define SHARP_H

#include <stdint.h>

enum { SHARP_OUT_OF_RANGE = 0, SHARP_NEAREST_MM = 95, SHARP_FARTHEST_MM = 850 };

/* Returns millimetres, or SHARP_OUT_OF_RANGE. Divides: call it from the main context. */
uint16_t sharp_mm(uint16_t counts);

#endif
