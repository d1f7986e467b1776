/* What the start-up left, and how the clock runs, for test_cortex_m.py to ask for. */
#include "j2a_functions.h"

static uint8_t given[] = {0x11, 0x22, 0x33, 0x44, 0x55}; /* an odd number of bytes */
static uint8_t zeros[33];

static void put_u64(uint8_t *bytes, uint64_t value) {
    j2a_put_u32(bytes, (uint32_t)value);
    j2a_put_u32(bytes + 4, (uint32_t)(value >> 32));
}

/* Replies the initialised variables and those of zeros, each byte changed by one since it was last asked. */
uint8_t initial(uint8_t *const length, uint8_t **const payload) {
    uint8_t i;
    for (i = 0; i < sizeof given; i++)
        (*payload)[i] = given[i]++;
    for (i = 0; i < sizeof zeros; i++)
        (*payload)[sizeof given + i] = zeros[i]++;
    *length = sizeof given + sizeof zeros;
    return 0;
}

/* Takes u16 milliseconds and u8 "with interrupts off". Reads both clocks for that long; replies u32 readings,
 * u32 steps back or apart of the clocks, u64 first and u64 last reading in microseconds. */
uint8_t watch(uint8_t *const length, uint8_t **const payload) {
    const uint32_t limit_us = ((*payload)[0] | (uint32_t)(*payload)[1] << 8) * 1000;
    const bool interrupts_off = (*payload)[2];
    uint32_t readings = 0, faults = 0;
    uint64_t first_us, last_us, now_us;

    if (interrupts_off)
        __asm__ volatile("cpsid i" ::: "memory");
    first_us = last_us = j2a_port_time_us();
    do {
        const uint16_t before_ms = j2a_port_ticks();
        uint16_t after_ms, now_ms;
        now_us = j2a_port_time_us();
        after_ms = j2a_port_ticks();
        now_ms = (uint16_t)(now_us / 1000);
        faults += now_us < last_us || (uint16_t)(now_ms - before_ms) > (uint16_t)(after_ms - before_ms);
        last_us = now_us;
        readings++;
    } while (now_us - first_us < limit_us);
    __asm__ volatile("cpsie i" ::: "memory");
    j2a_put_u32(*payload, readings);
    j2a_put_u32(*payload + 4, faults);
    put_u64(*payload + 8, first_us);
    put_u64(*payload + 16, last_us);
    *length = 24;
    return 0;
}

uint8_t get_time(uint8_t *const length, uint8_t **const payload) {
    put_u64(*payload, j2a_port_time_us());
    *length = 8;
    return 0;
}

void j2a_app_task(void) {
}
