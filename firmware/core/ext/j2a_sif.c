/* Server-initiated frames: a payload of the application flows to the sender.
 * Rules: each link counts its own; the boot SIF is the first, and its opcode is not for the application. */
#include "j2a_internal.h"

#if J2A_WITH_SIF

void j2a_send_sif(uint8_t opcode, uint8_t length, const uint8_t *payload) {
#if J2A_WITH_BOOT
    if (opcode == J2A_BOOT || !j2a_greet())
        return;
#endif
    j2a_send(J2A_SOS, j2a_served()->sif_seq++, opcode, length, payload);
}

#endif
