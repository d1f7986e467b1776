/* Encoders, distances, analog inputs, servos and a lamp. The wiring between drivers and host is in transds.def. */
#include "adc.h"
#include "pins.h"
#include "quad.h"
#include "servo.h"
#include "sharp_sensor.h"
#include "transds.h"

void lamp_set(uint8_t channel, bool on) {
    (void)channel; /* there is one lamp */
    if (on)
        LAMP_OUT |= _BV(LAMP_BIT);
    else
        LAMP_OUT &= (uint8_t)~_BV(LAMP_BIT);
}

uint16_t app_overruns(void) {
    return j2a_port_overruns();
}

void j2a_app_task(void) {
#if SENSORS_ADC
    sharp_task();
    adc_task();
#endif
    transds_process();
}

int main(int argc, char **argv) {
    j2a_selftest();
    j2a_port_init(argc, argv);
    LAMP_DDR |= _BV(LAMP_BIT);
    servo_init();
#if SENSORS_ADC
    adc_init();
#endif
    transds_init(); /* before the first edge */
    quad_init();
    for (;;) {
        j2a_task();
        j2a_app_task();
        j2a_port_idle();
    }
}
