/* The multiplication of the clock, for a chip whose own one takes less of the stack than the library's. */
#include "j2a_clock.h"
#include "j2a_functions.h"

void app_product(int32_t a, int32_t b, int32_t *high, uint32_t *low) {
    *high = j2a_product(a, b, low);
}

void j2a_app_task(void) {
}
