#include "receiver.h"

#include <string.h>

uint8_t receiver_sum(const uint8_t *body) {
    uint8_t value = (uint8_t)(body[0] ^ (body[1] + J2A_CHK_OPCODE) ^ (body[2] + J2A_CHK_LENGTH));
    size_t i;
    for (i = 0; i < body[2]; i++)
        value ^= body[3 + i];
    return value;
}

int receiver_take(receiver *r, uint8_t byte, receiver *old) {
    if (byte == J2A_SOF || byte == J2A_SOS) {
        const int result = r->start ? MARKER : NOTHING;
        *old = *r;
        memset(r, 0, sizeof *r);
        r->start = byte;
        return result;
    }
    if (!r->start)
        return NOTHING;
    if (!r->escaped && byte == J2A_ESC) {
        r->escaped = true;
        return NOTHING;
    }
    *old = *r;
    if (r->escaped && byte == 0xFF) {
        r->start = 0;
        return ESCAPE;
    }
    r->body[r->length++] = (uint8_t)(byte + r->escaped);
    r->escaped = false;
    if (r->length < 4 || r->length != 4u + r->body[2])
        return NOTHING;
    *old = *r;
    r->start = 0;
    return old->body[r->length - 1] == receiver_sum(old->body) ? GOOD : CHECKSUM;
}
