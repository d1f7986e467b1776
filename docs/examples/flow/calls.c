/* Functions of kind call: a payload comes in, another goes out, in the same place. */
#include "flow.h"

static uint8_t failed(uint8_t *length) {
    *length = 0;
    return J2A_RET_FAILED;
}

/* Replies u32: pulses since the start. */
uint8_t flow_total(uint8_t *const length, uint8_t **const payload) {
    j2a_put_u32(*payload, pulses_total());
    *length = 4;
    return J2A_RET_OK;
}

/* Takes u32: at so many pulses a SIF is sent. Returns ALARM_PASSED when it is too late for that. */
uint8_t flow_set_alarm(uint8_t *const length, uint8_t **const payload) {
    uint32_t at;
    if (*length != 4)
        return failed(length);
    at = j2a_get_u32(*payload);
    *length = 0;
    if (at <= pulses_total())
        return ALARM_PASSED;
    alarm_at(at);
    return J2A_RET_OK;
}

/* Replies text, which stays where it is. */
uint8_t flow_about(uint8_t *const length, uint8_t **const payload) {
    static uint8_t text[] = "0.1 l per pulse; wheel of 2026";
    *payload = text;
    *length = sizeof text - 1;
    return J2A_RET_OK;
}

/* Takes u8 windows, 1..10: counts for 2 ms in each, and sends what it has counted before it replies. */
uint8_t flow_measure(uint8_t *const length, uint8_t **const payload) {
    const uint8_t windows = (*payload)[0];
    uint8_t i;
    if (*length != 1 || windows < 1 || windows > 10)
        return failed(length);
    for (i = 0; i < windows; i++) {
        const uint32_t start_us = (uint32_t)j2a_port_time_us();
        const uint32_t before = pulses_total();
        uint8_t sif[3];
        uint32_t counted;
        while ((uint32_t)j2a_port_time_us() - start_us < 2000) {
        }
        counted = pulses_total() - before;
        sif[0] = i;
        sif[1] = (uint8_t)counted;
        sif[2] = (uint8_t)(counted >> 8);
        j2a_send_sif(SIF_MEASURED, sizeof sif, sif);
    }
    *length = 0;
    return J2A_RET_OK;
}
