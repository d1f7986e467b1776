/* See sharp_sensor.h. */
#include "sharp_sensor.h"

#include "adc.h"
#include "pins.h"
#include "sharp.h"
#include "triggered.h"
#include "wait.h"

static void (*callback)(uint8_t channel, uint16_t mm);

void sharp_set_cb(void (*new_value)(uint8_t channel, uint16_t mm)) {
    callback = new_value;
}

#ifdef ADC_INPUTS
static wait_t pause;
static bool is_scanning;
static uint8_t scans; /* that were over when it began; when it is over, if it was triggered */

void sharp_init(void) {
    adc_init();
}

void sharp_task(void) {
    if (is_scanning) {
        uint8_t channel;
        if (IS_TRIGGERED(sharp) ? (int8_t)(adc_scans() - scans) < 0 : adc_scans() == scans)
            return; /* another sensor's scans may have followed since */
        is_scanning = false;
        for (channel = 0; channel < ADC_COUNT; channel++)
            if (callback)
                callback(channel, sharp_mm(adc_get(channel)));
    } else if (!IS_TRIGGERED(sharp) && wait_is_over(&pause, SHARP_PERIOD_MS)) {
        wait_begin(&pause);
        is_scanning = true;
        scans = adc_scans();
        adc_start();
    }
}

void sharp_trigger(void) {
    is_scanning = true;
    scans = adc_scan();
}
#else
void sharp_init(void) {
}

void sharp_task(void) {
    static uint8_t channel;
    if (callback && channel < 255)
        callback(channel++, SHARP_OUT_OF_RANGE);
}

void sharp_trigger(void) {
}
#endif
