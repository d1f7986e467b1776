/* Data longer than a frame. A chunk flows in with the opcode of a function of kind many, out flows what that
 * made of it, in the same bytes.
 * Rule: what it says about its length is not believed. */
#include "j2a_internal.h"

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
