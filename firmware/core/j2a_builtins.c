/* The functions that each device has. A request's payload flows in, the reply's flows out in the
 * same J2A_ROOM bytes. */
#include <stddef.h>

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

#if J2A_WITH_MAPPING
uint8_t j2a_get_mapping(uint8_t *const length, uint8_t **const payload) {
    const uint8_t count = j2a_function_count;
    uint8_t n = 0;
    uint8_t i;
    for (i = 0; i < count; i++) {
        const char *name = j2a_flash_pointer(&j2a_entry_of(i)->name);
        uint8_t c;
        do {
            if (n == J2A_ROOM) { /* never a truncated map */
                *length = 0;
                return J2A_RET_FAILED;
            }
            c = j2a_flash_u8(name++);
            (*payload)[n++] = c;
        } while (c);
    }
    *length = n;
    return 0;
}
#endif

#if J2A_WITH_MANY
uint8_t j2a_many(uint8_t *const length, uint8_t **const payload) {
    uint8_t *const p = *payload;
    uint8_t *data = p + J2A_MANY_HEADER;
    j2a_function function;
    uint8_t n, i, code;
    uint32_t offset;
    bool is_last;

    if (*length < J2A_MANY_HEADER) {
        *length = 0;
        return J2A_RET_FAILED;
    }
    code = j2a_find(p[0], J2A_KIND_MANY, &function);
    if (code)
        return j2a_error(J2A_ERR_OPCODE, code, length, p);

    n = (uint8_t)(*length - J2A_MANY_HEADER);
    is_last = p[1] & J2A_FLAG_LAST;
    offset = j2a_get_u32(p + 2);
    code = ((j2a_many_fn *)function)(&is_last, p[1] & J2A_FLAG_WRITE, &offset, &n, &data);
    if (n > J2A_ROOM_MANY) {
        n = 0;
        code = J2A_RET_FAILED;
    }
    p[0] = code > J2A_RET_MAX ? J2A_RET_FAILED : code;
    p[1] = is_last ? J2A_FLAG_LAST : 0;
    j2a_put_u32(p + 2, offset);
    for (i = 0; i < n; i++) /* onto itself when the function left its data in place */
        p[J2A_MANY_HEADER + i] = data[i];
    *length = (uint8_t)(n + J2A_MANY_HEADER);
    return 0;
}
#endif

#if J2A_WITH_PROPERTIES
uint8_t j2a_get_properties(bool *is_last, bool is_write, uint32_t *const offset,
                           uint8_t *const length, uint8_t **const data) {
    const unsigned char *next = j2a_properties;
    size_t at = 0;
    uint8_t n = 0;
    uint8_t c, before = 0;

    *length = 0;
    if (is_write)
        return J2A_RET_FAILED;
    *is_last = true;
    /* An empty key ends the list: NUL at the very start, or after a value's NUL. */
    for (; (c = j2a_flash_u8(next)) != 0 || before != 0; before = c, next++, at++) {
        if (at < *offset)
            continue;
        if (n == J2A_ROOM_MANY) {
            *is_last = false;
            break;
        }
        (*data)[n++] = c;
    }
    *length = n;
#if J2A_WITH_SELFTEST
    if (*is_last)
        j2a_selftest_property(at, *offset, is_last, length, *data);
#endif
    return 0;
}
#endif

uint8_t j2a_echo(uint8_t *const length, uint8_t **const payload) {
    (void)length;
    (void)payload;
    return J2A_ECHO;
}

#if J2A_WITH_MANY
uint8_t j2a_echo_many(bool *is_last, bool is_write, uint32_t *const offset, uint8_t *const length,
                      uint8_t **const data) {
    (void)is_last;
    (void)is_write;
    (void)offset;
    (void)length;
    (void)data;
    return J2A_ECHO_MANY;
}
#endif
