/* The function map: out flow the names of all functions in opcode order, each with a NUL. With the interface, which
 * has them all, as many as fit (J2A-IFACE-007). */
#include "j2a_internal.h"

#if J2A_WITH_MAPPING

uint8_t j2a_get_mapping(uint8_t *const length, uint8_t **const payload) {
    const uint8_t count = j2a_function_count;
    uint8_t n = 0;
    uint8_t i;
    for (i = 0; i < count; i++) {
        const char *name = j2a_flash_pointer(&j2a_entry_of(i)->name);
        uint8_t c;
#if J2A_WITH_INTERFACE
        *length = n;
#endif
        do {
            if (n == J2A_ROOM) { /* never a truncated map */
#if J2A_WITH_INTERFACE
                return 0;
#else
                *length = 0;
                return J2A_RET_FAILED;
#endif
            }
            c = j2a_flash_u8(name++);
#if J2A_WITH_INTERFACE
            if (c == ' ' || c == '(') /* ends the name in its line */
                c = 0;
#endif
            (*payload)[n++] = c;
        } while (c);
    }
    *length = n;
    return 0;
}

#endif
