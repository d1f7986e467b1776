/* Mistakes of applications, on purpose: each shows the symptom that docs/in-your-firmware.md has for it. */
#include "j2a_functions.h"

/* Does not set *length. */
uint8_t mistake_unset(uint8_t *const length, uint8_t **const payload) {
    (void)length;
    (*payload)[0] = 1;
    return J2A_RET_OK;
}

/* Replies two bytes in the other order, and writes before it reads. */
uint8_t mistake_overwritten(uint8_t *const length, uint8_t **const payload) {
    if (*length != 2)
        return J2A_RET_FAILED;
    (*payload)[0] = (*payload)[1];
    (*payload)[1] = (*payload)[0];
    return J2A_RET_OK;
}

/* Returns a code of the protocol. */
uint8_t mistake_high(uint8_t *const length, uint8_t **const payload) {
    (void)payload;
    *length = 0;
    return 0xF1;
}

/* Takes longer than a host waits for. */
uint8_t mistake_slow(uint8_t *const length, uint8_t **const payload) {
    const uint64_t start_us = j2a_port_time_us();
    (void)payload;
    while (j2a_port_time_us() - start_us < 400000) {
    }
    *length = 0;
    return J2A_RET_OK;
}

/* Has no data, and does not say that they end. */
uint8_t mistake_endless(bool *is_last, bool is_write, uint32_t *const offset, uint8_t *const length,
                        uint8_t **const data) {
    (void)is_last;
    (void)is_write;
    (void)offset;
    (void)data;
    *length = 0;
    return J2A_RET_OK;
}

/* Has three bytes, and does not look at the offset. */
uint8_t mistake_repeated(bool *is_last, bool is_write, uint32_t *const offset, uint8_t *const length,
                         uint8_t **const data) {
    static uint8_t bytes[] = {1, 2, 3};
    (void)is_write;
    *data = bytes;
    *length = sizeof bytes;
    *is_last = *offset != 0;
    return J2A_RET_OK;
}

void j2a_app_task(void) {
}
