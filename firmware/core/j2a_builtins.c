/* The table of the built-in functions, and what each device has: a2jEcho, and numbers in payloads. The other
 * functions are in ext/, each with the optional part that it belongs to. */
#include "j2a_internal.h"

J2A_BUILTIN_TABLE(J2A_WEAK)

uint32_t j2a_get_u32(const uint8_t *bytes) {
    uint32_t value = 0;
    uint8_t i = 4;
    while (i--)
        value = value << 8 | bytes[i];
    return value;
}

void j2a_put_u32(uint8_t *bytes, uint32_t value) {
    uint8_t i;
    for (i = 0; i < 4; i++, value >>= 8)
        bytes[i] = (uint8_t)value;
}

uint8_t j2a_echo(uint8_t *const length, uint8_t **const payload) {
    (void)length;
    (void)payload;
    return J2A_ECHO;
}
