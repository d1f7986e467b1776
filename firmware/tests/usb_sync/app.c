/* Sends each packet of SyncUSB back as a SIF. */
#include "j2a_functions.h"

enum { SIF_SYNC = 1 };

void j2a_app_sync_usb(const uint8_t *packet) {
    j2a_send_sif(SIF_SYNC, J2A_SYNCUSB_SIZE, packet);
}

/* Takes u16 milliseconds and returns that much later. */
uint8_t sync_delay(uint8_t *const length, uint8_t **const payload) {
    const uint32_t delay_us = (uint32_t)((*payload)[0] | (uint16_t)(*payload)[1] << 8) * 1000;
    const uint64_t start_us = j2a_port_time_us();
    while (j2a_port_time_us() - start_us < delay_us) {
    }
    *length = 0;
    return 0;
}

void j2a_app_task(void) {
}
