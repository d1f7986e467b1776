/* An app with functions.def: one function, which replies a temperature in tenths of a degree. */
#include "j2a_functions.h"

uint8_t read_temperature(uint8_t *const length, uint8_t **const payload) {
    (*payload)[0] = 215;
    (*payload)[1] = 0;
    *length = 2;
    return J2A_RET_OK;
}

void j2a_app_task(void) {
}
