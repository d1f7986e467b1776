/* An application with one function. */
#include "j2a_functions.h"

int32_t app_add(int32_t a, int32_t b) {
    return a + b;
}

/* The application's share of the main loop. */
void j2a_app_task(void) {
}
