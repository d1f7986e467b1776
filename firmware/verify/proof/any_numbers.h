/* The two functions that those of j2a_numbers.h are made of, for a driver that defines the objects of any.h: what is read
 * is any number, what is written are its bytes. Included once, behind these objects. */
#ifndef ANY_NUMBERS_H
#define ANY_NUMBERS_H

#include "any.h"

uint32_t j2a_get_u32(const uint8_t *bytes) {
    (void)bytes;
    return any_u32;
}

void j2a_put_u32(uint8_t *bytes, uint32_t value) {
    uint8_t i;
    for (i = 0; i < 4; i++, value >>= 8)
        bytes[i] = (uint8_t)value;
}

#endif
