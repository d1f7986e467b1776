/* An application with one function. */
#include "j2a_functions.h"

/* Takes two i32, replies their sum; least significant byte first, as everywhere. */
uint8_t app_add(uint8_t *const length, uint8_t **const payload) {
    if (*length != 8) {
        *length = 0;
        return J2A_RET_FAILED;
    }
    j2a_put_u32(*payload, j2a_get_u32(*payload) + j2a_get_u32(*payload + 4));
    *length = 4;
    return 0;
}

/* The application's share of the main loop. */
void j2a_app_task(void) {
}
