/* The sender. A frame flows in as its fields, out go its wire bytes through j2a_port_tx().
 * Rule: one frame at a time, whole; so all of it runs in the main context. */
#include "j2a_internal.h"

static uint8_t put(uint8_t byte) {
    uint8_t wire = byte;
    if (byte == J2A_SOF || byte == J2A_SOS || byte == J2A_ESC) {
        j2a_tx_byte(J2A_ESC);
        wire--;
    }
    j2a_tx_byte(wire);
    return byte;
}

void j2a_send(uint8_t start, uint8_t seq, uint8_t opcode, uint8_t length, const uint8_t *payload) {
    uint8_t checksum;
    j2a_tx_byte(start);
    checksum = put(seq);
    checksum ^= (uint8_t)(put(opcode) + J2A_CHK_OPCODE);
    checksum ^= (uint8_t)(put(length) + J2A_CHK_LENGTH);
    while (length--)
        checksum ^= put(*payload++);
    put(checksum);
}

#if J2A_WITH_SIF
void j2a_send_sif(uint8_t opcode, uint8_t length, const uint8_t *payload) {
    j2a_send(J2A_SOS, j2a_rx.sif_seq++, opcode, length, payload);
}
#endif
