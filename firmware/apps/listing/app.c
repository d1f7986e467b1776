/* The sensor board of the thesis' listing 9.2, with the drivers of this project: encoders, infrared and ultrasonic
 * distances. A chip without an ADC or a TWI, such as an ATmega32U2, has nothing to measure distances with, so all
 * that it ever says of them is that there are none. */
#include "adc.h"
#include "pins.h"
#include "quad.h"
#include "sharp_sensor.h"
#include "srf02.h"
#include "transds.h"
#include "twi.h"

#ifndef ADC_INPUTS
static void (*sharp_value)(uint8_t channel, uint16_t mm);

void sharp_set_cb(void (*new_value)(uint8_t channel, uint16_t mm)) {
    sharp_value = new_value;
}

void sharp_task(void) {
    static uint8_t channel;
    if (channel < 8)
        sharp_value(channel++, 0);
}
#endif

void j2a_app_task(void) {
    sharp_task();
    srf02_task();
    transds_process();
}

int main(int argc, char **argv) {
    j2a_selftest();
    j2a_port_init(argc, argv);
    transds_init(); /* before the first edge */
    quad_init();
#ifdef ADC_INPUTS
    adc_init();
#endif
    twi_init();
    for (;;) {
        j2a_task();
        j2a_app_task();
        j2a_port_idle();
    }
}
