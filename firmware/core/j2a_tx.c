/* The sender. A frame flows in as its fields, out go its wire bytes through j2a_port_tx().
 * Rule: one frame at a time, whole; so all of it runs in the main context. */
#include "j2a_internal.h"

static J2A_NOINLINE void put(uint8_t byte) {
    if (byte == J2A_SOF || byte == J2A_SOS || byte == J2A_ESC) {
        j2a_tx_byte(J2A_ESC);
        byte--;
    }
    j2a_tx_byte(byte);
}

void j2a_send(uint8_t start, uint8_t seq, uint8_t opcode, uint8_t length, const uint8_t *payload) {
    uint8_t checksum = (uint8_t)(seq ^ (uint8_t)(opcode + J2A_CHK_OPCODE) ^ (uint8_t)(length + J2A_CHK_LENGTH));
    j2a_tx_byte(start);
    put(seq);
    put(opcode);
    put(length);
    while (length--) {
        const uint8_t byte = *payload++;
        checksum ^= byte;
        put(byte);
    }
    put(checksum);
}
