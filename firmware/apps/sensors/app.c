/* Encoders, distances, analog inputs, servos and a lamp. Which drivers there are is in transds.def alone. */
#include "drivers.h"
#include "pins.h"

void lamp_init(void) {
    LAMP_DDR |= _BV(LAMP_BIT);
}

void lamp_task(void) {
}

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
