#include "j2a_functions.h"

static bool light;
static uint32_t turns;

int32_t app_add(int32_t a, int32_t b) { return a + b; }
void app_led(bool on) { light = on; }
void j2a_app_task(void) { j2a_sif_counter(turns++); }
