/* The boot SIF: out flows, once after each reset and before anything else on a link, why the device began anew,
 * which start it is, and which interface it has (J2A-BOOT-001).
 * Rule: it waits until the port says that the link is up, and all other frames wait for it. */
#include "j2a_internal.h"

#if J2A_WITH_BOOT

/* In the port's j2a_port_config.h, where it knows more. */
#ifndef J2A_PORT_BOOT_CAUSE
#define J2A_PORT_BOOT_CAUSE J2A_BOOT_UNKNOWN
#endif

uint8_t J2A_WEAK j2a_boot_cause(void) {
    return J2A_PORT_BOOT_CAUSE;
}

uint16_t J2A_WEAK j2a_boot_count(void) {
    return 0;
}

bool j2a_greet(void) {
    j2a_rx_t *const rx = j2a_served();
    if (!rx->has_greeted && J2A_PORT_IS_UP) {
        uint8_t payload[J2A_BOOT_BYTES];
        payload[0] = j2a_boot_cause();
        j2a_put_u16(payload + 1, j2a_boot_count());
        j2a_put_u32(payload + 3, j2a_interface_hash());
        rx->has_greeted = true;
        j2a_send(J2A_SOS, rx->sif_seq++, J2A_BOOT, J2A_BOOT_BYTES, payload);
    }
    return rx->has_greeted;
}

#endif
