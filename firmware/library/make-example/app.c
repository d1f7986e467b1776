/* A whole device: one function, one property, the main loop. */
#include "j2a.h"

static uint8_t add(uint8_t *const length, uint8_t **const payload) {
    if (*length != 8) {
        *length = 0;
        return J2A_RET_FAILED;
    }
    j2a_put_u32(*payload, j2a_get_u32(*payload) + j2a_get_u32(*payload + 4));
    *length = 4;
    return J2A_RET_OK;
}

J2A_FUNCTIONS(J2A_CALL(add, add));
J2A_PROPERTIES(J2A_PROPERTY("name", "Adder"));

int main(int argc, char **argv) {
    j2a_port_init(argc, argv);
    for (;;) {
        j2a_task();
        j2a_port_idle();
    }
}
