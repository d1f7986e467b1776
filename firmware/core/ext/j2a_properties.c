/* Properties: out flows the list of keys and values that the application has in flash, chunk by chunk. */
#include "j2a_internal.h"

#if J2A_WITH_PROPERTIES

uint8_t j2a_get_properties(bool *is_last, bool is_write, uint32_t *const offset,
                           uint8_t *const length, uint8_t **const data) {
    const unsigned char *next = j2a_properties;
    size_t at = 0;
    uint32_t skip = *offset;
    uint8_t n = 0;
    uint8_t c, before = 0;

    *length = 0;
    if (is_write)
        return J2A_RET_FAILED;
    *is_last = true;
    /* An empty key ends the list: NUL at the very start, or after a value's NUL. */
    for (; (c = j2a_flash_u8(next)) != 0 || before != 0; before = c, next++, at++) {
        if (skip != 0) {
            skip--;
            continue;
        }
        if (n == J2A_ROOM_MANY) {
            *is_last = false;
            break;
        }
        (*data)[n++] = c;
    }
    *length = n;
    (void)at; /* without the parts below */
#if J2A_WITH_INTERFACE
    if (*is_last)
        j2a_interface_property(at, *offset, is_last, length, *data);
#endif
#if J2A_WITH_SELFTEST
    if (*is_last)
        j2a_selftest_property(at + J2A_INTERFACE_BYTES, *offset, is_last, length, *data);
#endif
    return 0;
}

#endif
