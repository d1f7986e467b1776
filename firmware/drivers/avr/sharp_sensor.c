/* See sharp_sensor.h. Empty on chips without an ADC. */
#include "sharp_sensor.h"

#include "adc.h"
#include "pins.h"
#include "sharp.h"
#include "wait.h"

#ifdef ADC_INPUTS
static void (*callback)(uint8_t channel, uint16_t mm);
static wait_t pause;
static bool is_scanning;

void sharp_set_cb(void (*new_value)(uint8_t channel, uint16_t mm)) {
    callback = new_value;
}

void sharp_task(void) {
    if (is_scanning) {
        uint8_t channel;
        if (adc_busy())
            return;
        is_scanning = false;
        for (channel = 0; channel < ADC_COUNT; channel++)
            if (callback)
                callback(channel, sharp_mm(adc_get(channel)));
    } else if (wait_is_over(&pause, SHARP_PERIOD_MS)) {
        wait_begin(&pause);
        is_scanning = true;
        adc_start();
    }
}
#else
typedef int sharp_sensor_is_missing; /* C has no empty files */
#endif
