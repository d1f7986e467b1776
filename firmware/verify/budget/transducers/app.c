/* Transducers whose drivers do nothing: what they cost besides the drivers. */
#include "transds.h"

void (*measured)(uint8_t channel, int16_t value);

void wheel_set_cb(void (*callback)(uint8_t channel, int16_t value)) {
    measured = callback;
}

#if BUDGET_MORE == 4
volatile int16_t moved;

void horn_set(uint8_t channel, int16_t value) {
    (void)channel;
    moved = value;
}
#endif

#if BUDGET_MORE == 7
void (*seen)(uint8_t channel, uint16_t value);

void sharp_set_cb(void (*callback)(uint8_t channel, uint16_t value)) {
    seen = callback;
}
#elif BUDGET_MORE == 8
void (*heard)(uint8_t channel, uint32_t value);

void srf02_set_cb(void (*callback)(uint8_t channel, uint32_t value)) {
    heard = callback;
}
#endif

void j2a_app_task(void) {
    transds_process();
}

int main(int argc, char **argv) {
    j2a_port_init(argc, argv);
    transds_init();
    for (;;) {
        j2a_task();
        j2a_app_task();
        j2a_port_idle();
    }
}
