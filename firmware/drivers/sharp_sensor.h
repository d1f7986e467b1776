/* Infrared distance sensors on the analog inputs of adc.h. In: their voltages. Out: a call for each with its millimetres,
 * each SHARP_PERIOD_MS, which is about how often they measure themselves; SHARP_OUT_OF_RANGE where they see nothing.
 * Rules: sharp_task() never waits, and is called in each turn of the main loop; the callback runs in it, because the
 * arithmetic divides. It begins its own scans; adc_task(), if there is one, comes behind it, or it may find a scan
 * running each time. */
#ifndef SHARP_SENSOR_H
#define SHARP_SENSOR_H

#include <stdint.h>

enum { SHARP_PERIOD_MS = 40 };

/* The callback for new values, NULL for none. */
void sharp_set_cb(void (*new_value)(uint8_t channel, uint16_t mm));

void sharp_task(void);

#endif
