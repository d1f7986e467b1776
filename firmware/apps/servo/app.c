/* Encoders to the host, servos from it: the demonstration of the thesis, chapter 9. The wiring is in transds.def. */
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
