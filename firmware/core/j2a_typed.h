/* What the functions that are made of typed entries share: the check of the length, failing, and memory as a
 * function of kind many. In: what a request brought. Out: what a reply carries.
 * Rules: no RAM. The code of a failure is in a byte of the parser that is unused while a request waits for its
 * reply; interrupts that push bytes leave that alone, because bytes are refused then. With several links it has
 * a byte of its own, because a function may set j2a_link. */
#ifndef J2A_TYPED_H
#define J2A_TYPED_H

#include "j2a_state.h"

#ifdef __cplusplus
extern "C" {
#endif

#if J2A_LINKS > 1
extern uint8_t j2a_failure;
#else
#define j2a_failure (j2a_rx_of[0].checksum)
#endif

/* Makes the typed function that runs fail (J2A-TYPE-006): its reply carries the code and no results.
 * code: 1..J2A_RET_MAX, what it means is the application's affair; any other one is sent as J2A_RET_FAILED.
 * Returns 0, for "return j2a_fail(3);" where the result is a number. */
J2A_INLINE uint8_t j2a_fail(uint8_t code) {
    j2a_failure = (uint8_t)(code - (code == 0)); /* SDCC warns of ?: when the code is a constant */
    return 0;
}

/* Begins a typed function: the request must have so many bytes (J2A-TYPE-005). */
J2A_INLINE bool j2a_begin(uint8_t *length, uint8_t size) {
    j2a_failure = 0;
    if (*length == size)
        return true;
    *length = 0;
    return false;
}

/* The same with an open end: units of `unit` bytes behind the first `size` bytes, at most `most` of them. */
J2A_INLINE bool j2a_begin_open(uint8_t *length, uint8_t size, uint8_t unit, uint16_t most) {
    const uint8_t rest = (uint8_t)(*length - size);
    j2a_failure = 0;
    if (*length >= size && rest % unit == 0 && rest / unit <= most)
        return true;
    *length = 0;
    return false;
}

/* Ends a typed function. size: of its results. Returns what the function of kind call returns. */
J2A_INLINE uint8_t j2a_end(uint8_t *length, uint8_t size) {
    const uint8_t code = j2a_failure;
    *length = code == 0 ? size : 0;
    return code;
}

/* Copies bytes, also to where a part of them is: backwards if the first place is one of them. */
J2A_INLINE void j2a_move(uint8_t *to, const uint8_t *from, uint8_t count) {
    const uint8_t *const first = to;
    uint8_t i = 0;
    while (i < count && from + i != first)
        i++;
    if (i < count) {
        for (; count != 0; count--)
            to[count - 1] = from[count - 1];
    } else {
        for (i = 0; i < count; i++)
            to[i] = from[i];
    }
}

/* Puts bytes of an open end behind other fields.
 * most: of them by their type. room: in bytes.
 * Returns where the next byte would go, null if they are more than that. */
J2A_INLINE uint8_t *j2a_put_open(uint8_t *to, const uint8_t *from, uint8_t count, uint16_t most, uint8_t room) {
    if (count > most || count > room)
        return 0;
    j2a_move(to, from, count);
    return to + count;
}

/* Leaves bytes of any number as the last result: in place where they are the only one, else as a copy behind the
 * others. size: of the others in bytes. bytes, count: what the function left. most: of them.
 * Returns how many bytes were left, 0 after a failure. */
J2A_INLINE uint8_t j2a_leave(uint8_t **payload, uint8_t size, uint8_t *bytes, uint8_t count, uint16_t most) {
    const uint8_t room = size == 0 ? (uint8_t)J2A_MAX_PAYLOAD : (uint8_t)(J2A_ROOM - size);
    if (j2a_failure != 0)
        return 0;
    if (count > most || count > room)
        return j2a_fail(J2A_RET_FAILED);
    if (size == 0)
        *payload = bytes;
    else
        j2a_move(*payload + size, bytes, count);
    return count;
}

/* A memory block of the application as a function of kind many, J2A_BUFFER in functions.def.
 * memory, size: of the block, in bytes. unit: bytes of an element, a power of two.
 * The others: see J2A_DECLARE_MANY. */
J2A_INLINE uint8_t j2a_buffer(uint8_t *memory, uint32_t size, uint8_t unit, bool *is_last, bool is_write,
                                 uint32_t offset, uint8_t *length, uint8_t *data) {
    const uint16_t one = 1;
    const uint8_t flip = *(const uint8_t *)&one ? 0 : (uint8_t)(unit - 1); /* on a machine that is big-endian */
    const uint32_t left = offset < size ? size - offset : 0;
    uint8_t n = *length;
    uint8_t i;

    *length = 0;
    if (is_write) {
        if (offset > size || n > left)
            return J2A_RET_FAILED;
        for (i = 0; i < n; i++)
            memory[(offset + i) ^ flip] = data[i];
        return 0;
    }
    *is_last = left <= J2A_ROOM_MANY;
    n = (uint8_t)(*is_last ? left : J2A_ROOM_MANY);
    for (i = 0; i < n; i++)
        data[i] = memory[(offset + i) ^ flip];
    *length = n;
    return 0;
}

#ifdef __cplusplus
}
#endif

#endif
