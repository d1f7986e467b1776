/* Numbers in payloads, least significant byte first on every machine (J2A-TYPE-001): j2a_get_u16(bytes) returns the
 * number that begins at bytes, j2a_put_u16(bytes, value) writes it there. The same for bool, u8 to u64, i8 to i64, f32
 * and f64; there is no f64 where double has 4 bytes, as on AVR. */
#ifndef J2A_NUMBERS_H
#define J2A_NUMBERS_H

#include <float.h>
#include <stdbool.h>
#include <stdint.h>

#include "j2a_progmem.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Reads a number from a payload. There is the same for the other types, such as j2a_get_u16() and
 * j2a_get_f32().
 * bytes: 4 bytes, the least significant first.
 * Returns the number. */
uint32_t j2a_get_u32(const uint8_t *bytes);

/* Writes a number into a payload. There is the same for the other types.
 * bytes: room for 4 bytes, the least significant first.
 * value: the number. */
void j2a_put_u32(uint8_t *bytes, uint32_t value);

/* Within the functions below and those of j2a_table.c: an AVR loads four bytes in less code than it needs
 * for a loop, or for a call. */
#ifdef __AVR__
J2A_INLINE uint32_t j2a_load_u32(const uint8_t *bytes) {
    uint32_t value;
    __builtin_memcpy(&value, bytes, sizeof value);
    return value;
}

J2A_INLINE void j2a_store_u32(uint8_t *bytes, uint32_t value) {
    __builtin_memcpy(bytes, &value, sizeof value);
}
#else
#define j2a_load_u32 j2a_get_u32
#define j2a_store_u32 j2a_put_u32
#endif

J2A_INLINE bool j2a_get_bool(const uint8_t *bytes) {
    return bytes[0] != 0;
}

J2A_INLINE void j2a_put_bool(uint8_t *bytes, bool value) {
    bytes[0] = value ? 1 : 0;
}

J2A_INLINE uint8_t j2a_get_u8(const uint8_t *bytes) {
    return bytes[0];
}

J2A_INLINE void j2a_put_u8(uint8_t *bytes, uint8_t value) {
    bytes[0] = value;
}

J2A_INLINE uint16_t j2a_get_u16(const uint8_t *bytes) {
    return (uint16_t)(bytes[0] | (uint16_t)((uint16_t)bytes[1] << 8));
}

J2A_INLINE void j2a_put_u16(uint8_t *bytes, uint16_t value) {
    bytes[0] = (uint8_t)value;
    bytes[1] = (uint8_t)(value >> 8);
}

J2A_INLINE uint64_t j2a_get_u64(const uint8_t *bytes) {
    return j2a_load_u32(bytes) | (uint64_t)j2a_load_u32(bytes + 4) << 32;
}

J2A_INLINE void j2a_put_u64(uint8_t *bytes, uint64_t value) {
    j2a_store_u32(bytes, (uint32_t)value);
    j2a_store_u32(bytes + 4, (uint32_t)(value >> 32));
}

/* All compilers that we know keep the bits when a number becomes one with a sign. */
J2A_INLINE int8_t j2a_get_i8(const uint8_t *bytes) {
    return (int8_t)bytes[0];
}

J2A_INLINE void j2a_put_i8(uint8_t *bytes, int8_t value) {
    bytes[0] = (uint8_t)value;
}

J2A_INLINE int16_t j2a_get_i16(const uint8_t *bytes) {
    return (int16_t)j2a_get_u16(bytes);
}

J2A_INLINE void j2a_put_i16(uint8_t *bytes, int16_t value) {
    j2a_put_u16(bytes, (uint16_t)value);
}

J2A_INLINE int32_t j2a_get_i32(const uint8_t *bytes) {
    return (int32_t)j2a_load_u32(bytes);
}

J2A_INLINE void j2a_put_i32(uint8_t *bytes, int32_t value) {
    j2a_store_u32(bytes, (uint32_t)value);
}

J2A_INLINE int64_t j2a_get_i64(const uint8_t *bytes) {
    return (int64_t)j2a_get_u64(bytes);
}

J2A_INLINE void j2a_put_i64(uint8_t *bytes, int64_t value) {
    j2a_put_u64(bytes, (uint64_t)value);
}

/* IEEE 754, in the byte order of integers. A union, because memcpy() would need a library. */
J2A_INLINE float j2a_get_f32(const uint8_t *bytes) {
    union {
        uint32_t bits;
        float value;
    } number;
    number.bits = j2a_load_u32(bytes);
    return number.value;
}

J2A_INLINE void j2a_put_f32(uint8_t *bytes, float value) {
    union {
        float value;
        uint32_t bits;
    } number;
    number.value = value;
    j2a_store_u32(bytes, number.bits);
}

#if DBL_MANT_DIG == 53
J2A_INLINE double j2a_get_f64(const uint8_t *bytes) {
    union {
        uint64_t bits;
        double value;
    } number;
    number.bits = j2a_get_u64(bytes);
    return number.value;
}

J2A_INLINE void j2a_put_f64(uint8_t *bytes, double value) {
    union {
        double value;
        uint64_t bits;
    } number;
    number.value = value;
    j2a_put_u64(bytes, number.bits);
}
#endif

#ifdef __cplusplus
}
#endif

#endif
