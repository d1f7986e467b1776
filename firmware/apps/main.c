/* The main loop that the apps share. */
#include "j2a.h"

int main(int argc, char **argv) {
    j2a_selftest();
    j2a_port_init(argc, argv);
    for (;;) {
        j2a_task();
        j2a_app_task();
        j2a_port_idle();
    }
}
