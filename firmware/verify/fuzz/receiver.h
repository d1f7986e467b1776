/* A second receiver, which has nothing of the core's: it collects a frame whole and then judges it, as
 * the oracle of the specification does. In: the bytes of one direction of the link. Out: what ends. */
#ifndef RECEIVER_H
#define RECEIVER_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "j2a_const.h"

/* body: what came of the frame that is open, unstuffed. */
typedef struct {
    uint8_t start; /* 0 between frames */
    bool escaped;
    size_t length;
    uint8_t body[4 + J2A_MAX_PAYLOAD];
} receiver;

enum { NOTHING, GOOD, MARKER, ESCAPE, CHECKSUM };

/* Returns the checksum of seq, opcode, length and payload in body. */
uint8_t receiver_sum(const uint8_t *body);

/* Takes a byte. Returns what ended with it; the frame is in old. */
int receiver_take(receiver *r, uint8_t byte, receiver *old);

#endif
