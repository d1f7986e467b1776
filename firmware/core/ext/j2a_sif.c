/* Server-initiated frames: a payload of the application flows to the sender.
 * Rule: each link counts its own. */
#include "j2a_internal.h"

#if J2A_WITH_SIF

void j2a_send_sif(uint8_t opcode, uint8_t length, const uint8_t *payload) {
    j2a_send(J2A_SOS, j2a_served()->sif_seq++, opcode, length, payload);
}

#endif
