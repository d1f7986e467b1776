/* The sensor board of the thesis' listing 9.2, with the drivers of this project: encoders, infrared and ultrasonic
 * distances. A chip without an ADC or a TWI, such as an ATmega32U2, has nothing to measure distances with, so all
 * that it ever says of them is that there are none. */
#include "drivers.h"

void j2a_app_task(void) {
    drivers_task();
    transds_process();
}

int main(int argc, char **argv) {
    j2a_selftest();
    j2a_port_init(argc, argv);
    transds_init();
    drivers_init();
    for (;;) {
        j2a_task();
        j2a_app_task();
        j2a_port_idle();
    }
}
