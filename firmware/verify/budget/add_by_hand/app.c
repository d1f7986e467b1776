/* What verify/budget/add_typed does, by hand: a function takes two i32, checks the length of its payload, and
 * returns the sum. */
#include "j2a_functions.h"

uint8_t add_by_hand(uint8_t *const length, uint8_t **const payload) {
    if (*length != 8) {
        *length = 0;
        return J2A_RET_FAILED;
    }
    j2a_put_u32(*payload, j2a_get_u32(*payload) + j2a_get_u32(*payload + 4));
    *length = 4;
    return 0;
}

void j2a_app_task(void) {
}
