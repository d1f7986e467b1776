/* Infrared distance sensors on the analog inputs of adc.h. In: their voltages. Out: a call for each with its millimetres,
 * each SHARP_PERIOD_MS, which is about how often they measure themselves; SHARP_OUT_OF_RANGE where they see nothing.
 * Rules: sharp_task() never waits, and is called in each turn of the main loop; the callback runs in it, because the
 * arithmetic divides. It begins its own scans; with the key trigger one for each sharp_trigger(), and no others. A chip
 * without an ADC has nothing to measure with, so all that it ever says is SHARP_OUT_OF_RANGE, once for each channel. */
#ifndef SHARP_SENSOR_H
#define SHARP_SENSOR_H

#include <stdint.h>

enum { SHARP_PERIOD_MS = 40 };

/* The callback for new values, NULL for none. */
void sharp_set_cb(void (*new_value)(uint8_t channel, uint16_t mm));

/* Switches the ADC on. */
void sharp_init(void);

void sharp_task(void);

/* Measures once. */
void sharp_trigger(void);

#endif
