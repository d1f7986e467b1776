/* What an app should not do: `deaf` keeps the interrupts off for as many milliseconds as its payload says, so
 * that bytes are lost in the UART itself. For the RP2040. */
#include "j2a_functions.h"

uint8_t deaf(uint8_t *const length, uint8_t **const payload) {
    const uint64_t end_us = j2a_port_time_us() + **payload * 1000u;
    __asm__ volatile("cpsid i");
    while (j2a_port_time_us() < end_us) {
    }
    __asm__ volatile("cpsie i");
    *length = 2;
    (*payload)[0] = (uint8_t)j2a_port_overruns();
    (*payload)[1] = 0;
    return 0;
}

void j2a_app_task(void) {
}
