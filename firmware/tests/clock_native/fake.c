/* A port without hardware for the clock alone: whoever loads it sets the local time and the last frame.
 * Rule: fake_hook, if set, is called each time the core asks for the time, so a test interrupts it there. */
#include "j2a_clock.h"

uint64_t fake_local_us;
uint32_t fake_step_us; /* by which each look at the local time moves it on */
void (*fake_hook)(void);
#if J2A_PORT_FRAMES
j2a_frame fake_frame;
bool fake_has_frame;

bool j2a_port_frame(j2a_frame *last) {
    *last = fake_frame;
    return fake_has_frame;
}
#endif

uint64_t j2a_port_time_us(void) {
    fake_local_us += fake_step_us;
    if (fake_hook)
        fake_hook();
    return fake_local_us;
}

void j2a_port_wait(uint32_t local_us) {
    const int32_t left_us = (int32_t)(local_us - (uint32_t)fake_local_us);
    if (left_us > 0)
        fake_local_us += (uint32_t)left_us;
}

uint32_t j2a_get_u32(const uint8_t *bytes) {
    return bytes[0] | (uint32_t)bytes[1] << 8 | (uint32_t)bytes[2] << 16 | (uint32_t)bytes[3] << 24;
}

void j2a_put_u32(uint8_t *bytes, uint32_t value) {
    uint8_t i;
    for (i = 0; i < 4; i++)
        bytes[i] = (uint8_t)(value >> 8 * i);
}

uint8_t fake_call(uint8_t *length, uint8_t *payload);
void fake_run(uint64_t until_us, uint32_t every_us);

/* Calls a2jClock at a local time. Returns the code; *length and payload: in the request, out the reply. */
uint8_t fake_call(uint8_t *length, uint8_t *payload) {
    j2a_received_us = fake_local_us;
    return j2a_clock(length, &payload);
}

/* Lets the local time pass, with a turn of the main loop each `every_us`. */
void fake_run(uint64_t until_us, uint32_t every_us) {
    while (until_us - fake_local_us > every_us && fake_local_us < until_us) {
        fake_local_us += every_us;
        j2a_clock_turn();
    }
    if (fake_local_us < until_us)
        fake_local_us = until_us;
}

#if J2A_PORT_FRAMES
void fake_pass(uint32_t count, uint32_t frames);

/* Lets frames of 1000 us pass, with a turn of the main loop behind the start of the last one of each `frames`. */
void fake_pass(uint32_t count, uint32_t frames) {
    for (; count != 0; count--) {
        fake_local_us += (uint64_t)frames * 1000;
        fake_frame.number = (uint16_t)((fake_frame.number + frames) & (J2A_CLOCK_FRAME_NUMBERS - 1));
        fake_frame.began += frames * 16000;
        j2a_clock_turn();
    }
}
#endif
