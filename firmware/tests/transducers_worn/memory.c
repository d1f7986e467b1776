/* A memory of which one byte is worn: it takes none. Whoever loads it says which one, by worn_at. */
#include "j2a_port.h"

uint16_t worn_at = UINT16_MAX;
uint32_t worn_writes; /* to that byte */
static uint8_t bytes[J2A_PORT_KEPT_BYTES];

uint8_t j2a_port_kept(uint16_t at) {
    return bytes[at];
}

bool j2a_port_keep(uint16_t at, uint8_t byte) {
    if (bytes[at] == byte)
        return true;
    if (at == worn_at)
        worn_writes++;
    else
        bytes[at] = byte;
    return false;
}
