#include "transds.h"

static void (*quad_cb)(uint8_t channel, int16_t value);
static void (*sharp_cb)(uint8_t channel, uint16_t value);

/* A driver keeps what it shall call with each new value. It may do so in an interrupt. */
void quad_set_cb(void (*callback)(uint8_t channel, int16_t value)) {
    quad_cb = callback;
}

void sharp_set_cb(void (*callback)(uint8_t channel, uint16_t value)) {
    sharp_cb = callback;
}

/* Here a wheel turns with the servo. */
void servo_set(uint8_t channel, int8_t percent) {
    quad_cb(channel, (int16_t)(10 * percent));
}

void j2a_app_task(void) {
    static bool begun;
    if (!begun) {
        begun = true;
        transds_init();
        sharp_cb(0, 400);
    }
    transds_process();
}
