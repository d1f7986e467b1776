/* A typed function, to be compared with the same by hand in verify/budget/add_by_hand. */
#include "j2a_functions.h"

int32_t app_add(int32_t a, int32_t b) {
    return (int32_t)((uint32_t)a + (uint32_t)b);
}

void j2a_app_task(void) {
}
