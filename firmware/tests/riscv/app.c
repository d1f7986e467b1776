/* Shows what the start-up has made of the variables, and the clock where the lower half of mtime wraps: it
 * is set to 1.6 s before that. Every 10 ms a SIF says what time it is. */
#include "j2a_functions.h"
#include "virt.h"

enum { SIF_TIME = 1, PERIOD_US = 10000 };

static uint8_t initial[] = {0x11, 0x22, 0x33, 0x44, 0x55};
static uint8_t zero[64];
static uint64_t next_us;

/* Replies all variables that have a value from the start on. Then they change. */
uint8_t test_memory(uint8_t *const length, uint8_t **const payload) {
    uint8_t n = 0;
    uint8_t i;
    for (i = 0; i < sizeof initial; i++)
        (*payload)[n++] = initial[i]++;
    for (i = 0; i < sizeof zero; i++)
        (*payload)[n++] = zero[i]++;
    *length = n;
    return 0;
}

static void put_time(uint8_t *bytes, uint64_t us) {
    j2a_put_u32(bytes, (uint32_t)us);
    j2a_put_u32(bytes + 4, (uint32_t)(us >> 32));
    j2a_put_u32(bytes + 8, MTIME_HIGH);
}

/* Replies the time in microseconds, u64, and the upper half of mtime, u32. */
uint8_t test_get_time(uint8_t *const length, uint8_t **const payload) {
    put_time(*payload, j2a_port_time_us());
    *length = 12;
    return 0;
}

/* Takes u16 milliseconds, and reads the clock for so long. Replies how often, u32, and how often it went
 * back, u32. */
uint8_t test_watch(uint8_t *const length, uint8_t **const payload) {
    const uint32_t end_us = ((*payload)[0] | (uint32_t)(*payload)[1] << 8) * 1000;
    const uint64_t start_us = j2a_port_time_us();
    uint64_t last_us = start_us;
    uint32_t readings = 0;
    uint32_t faults = 0;
    while (last_us - start_us < end_us) {
        const uint64_t now_us = j2a_port_time_us();
        readings++;
        if (now_us < last_us)
            faults++;
        last_us = now_us;
    }
    j2a_put_u32(*payload, readings);
    j2a_put_u32(*payload + 4, faults);
    *length = 8;
    return 0;
}

void j2a_app_task(void) {
    const uint64_t now_us = j2a_port_time_us();
    uint8_t payload[12];
    if (now_us < next_us)
        return;
    next_us = now_us + PERIOD_US;
    put_time(payload, now_us);
    j2a_send_sif(SIF_TIME, sizeof payload, payload);
}

int main(void) {
    MTIME = 0xFF000000;
    MTIME_HIGH = 0;
    j2a_port_init(0, 0);
    for (;;) {
        j2a_task();
        j2a_app_task();
        j2a_port_idle();
    }
}
