/* Declares what the application lists in its functions.def, so that the compiler compares it with what is
 * defined. Lines of functions.def:
 *   J2A_FUNCTION(name, result, (type, parameter), ..., "text")   a typed function, app_name() in C
 *   J2A_BUFFER(name, type, length, "text")                       memory that hosts read and write, app_name[]
 *   J2A_SIF(name, opcode, (type, field), ..., "text")            makes j2a_sif_name(), which sends a typed SIF
 *   J2A_STRUCT(name, (type, field), ...)                         a structure, a type of C
 *   J2A_ENUM(name, integer, (value, number), ...)                an enumeration, its values name_value in C
 *   J2A_CALL(name on the wire, C function)                       a function that reads its payload itself
 *   J2A_MANY(name on the wire, C function)                       one for a2jMany
 * firmware/README.md says what types and results there are. */
#ifndef J2A_FUNCTIONS_H
#define J2A_FUNCTIONS_H

#include "j2a_fields.h"
#include "j2a_typed.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Of each element: j2a_c_NAME, its type in C; j2a_arg_NAME, that of a parameter, by which a structure is a
 * pointer; j2a_size_NAME, its bytes in a payload, and j2a_bools_NAME, those of a bool; j2a_take_NAME(pointer to a value, bytes) and
 * j2a_put_NAME(bytes, argument); and j2a_as_NAME(pointer to a value), the argument. No function returns a structure:
 * SDCC cannot. */
#define J2A_ELEMENT_OF_C(element, type, size, bools) \
    typedef type j2a_c_##element; \
    typedef type j2a_arg_##element; \
    enum { j2a_size_##element = size, j2a_bools_##element = bools };
#define J2A_SCALAR(element, type, size, bools) \
    J2A_ELEMENT_OF_C(element, type, size, bools) \
    J2A_INLINE void j2a_take_##element(type *value, const uint8_t *bytes) { \
        *value = j2a_get_##element(bytes); \
    } \
    J2A_INLINE type j2a_as_##element(const type *value) { \
        return *value; \
    }
#ifdef bool /* in C99 a macro, which is replaced before its name is used */
#define j2a_get__Bool j2a_get_bool
#define j2a_put__Bool j2a_put_bool
J2A_SCALAR(_Bool, _Bool, 1, 1)
#else
J2A_SCALAR(bool, bool, 1, 1)
#endif
J2A_SCALAR(u8, uint8_t, 1, 0)
J2A_SCALAR(u16, uint16_t, 2, 0)
J2A_SCALAR(u32, uint32_t, 4, 0)
J2A_SCALAR(u64, uint64_t, 8, 0)
J2A_SCALAR(i8, int8_t, 1, 0)
J2A_SCALAR(i16, int16_t, 2, 0)
J2A_SCALAR(i32, int32_t, 4, 0)
J2A_SCALAR(i64, int64_t, 8, 0)
J2A_SCALAR(f32, float, 4, 0)
#if DBL_MANT_DIG == 53
J2A_SCALAR(f64, double, 8, 0)
#else /* no such name: it is what the compiler says of an f64 */
#define j2a_c_f64 j2a_f64_needs_a_double_of_8_bytes
#define j2a_arg_f64 j2a_f64_needs_a_double_of_8_bytes
#define j2a_size_f64 j2a_f64_needs_a_double_of_8_bytes
#define j2a_bools_f64 0
#endif
J2A_ELEMENT_OF_C(text, char, 1, 0)
J2A_ELEMENT_OF_C(bytes, uint8_t, 1, 0)

/* Bytes of the fields in a payload; what is open counts as none. */
#define J2A_BYTES(none, item) J2A_IF_FIELD(J2A_BYTES_OF, item)
#define J2A_BYTES_OF(type, ...) J2A_BY_FORM(J2A_BYTES_, type, __VA_ARGS__)
#define J2A_BYTES_ONE(element, name, n) + (int)j2a_size_##element
#define J2A_BYTES_FIXED(element, name, n) + (n) * (int)j2a_size_##element
#define J2A_BYTES_OPEN(element, name, n)
#define J2A_BYTES_LIST(element, name, n)
#define J2A_BOOLS(none, item) J2A_IF_FIELD(J2A_BOOLS_OF, item)
#define J2A_BOOLS_OF(type, ...) J2A_BY_FORM(J2A_BOOLS_, type, __VA_ARGS__)
#define J2A_BOOLS_ONE(element, name, n) + (int)j2a_bools_##element
#define J2A_BOOLS_FIXED(element, name, n) + (n) * (int)j2a_bools_##element

/* Parameters: of functions and SIFs, and those by which functions leave results. */
#define J2A_IN(none, item) J2A_IF_FIELD(J2A_IN_OF, item)
#define J2A_IN_OF(type, ...) J2A_BY_FORM(J2A_IN_, type, __VA_ARGS__)
#define J2A_IN_ONE(element, name, n) , j2a_arg_##element in_##name
#define J2A_IN_FIXED(element, name, n) , const j2a_c_##element in_##name[n]
#define J2A_IN_OPEN(element, name, n) , const j2a_c_##element *in_##name, uint8_t length_of_##name
#define J2A_IN_LIST(element, name, n) , const j2a_c_##element *in_##name, uint8_t length_of_##name
#define J2A_OUT(none, item) J2A_IF_FIELD(J2A_OUT_OF, item)
#define J2A_OUT_OF(type, ...) J2A_BY_FORM(J2A_OUT_, type, __VA_ARGS__)
#define J2A_OUT_ONE(element, name, n) , j2a_c_##element *out_##name
#define J2A_OUT_FIXED(element, name, n) , j2a_c_##element out_##name[n]
#define J2A_OUT_OPEN(element, name, n) , j2a_c_##element **out_##name, uint8_t *size_of_##name
#define J2A_OUT_LIST(element, name, n) , j2a_c_##element **out_##name, uint8_t *size_of_##name

/* What a function of C returns. */
#define J2A_RETURNS(result) J2A_BY_SHAPE(J2A_RETURNS_, result)
#define J2A_RETURNS_VOID(r) void
#define J2A_RETURNS_ONE(r) J2A_PASTE1(j2a_c_, J2A_HEAD(r))
#define J2A_RETURNS_FIXED(r) void
#define J2A_RETURNS_OPEN(r) void
#define J2A_RETURNS_LIST(r) void
#define J2A_RETURNS_NAMED(r) void

/* Fields of a structure. */
#define J2A_MEMBER(none, item) J2A_IF_FIELD(J2A_MEMBER_OF, item)
#define J2A_MEMBER_OF(type, ...) J2A_BY_FORM(J2A_MEMBER_, type, __VA_ARGS__)
#define J2A_MEMBER_ONE(element, name, n) j2a_c_##element name;
#define J2A_MEMBER_FIXED(element, name, n) j2a_c_##element name[n];
#define J2A_TAKE_MEMBER(none, item) J2A_IF_FIELD(J2A_TAKE_MEMBER_OF, item)
#define J2A_TAKE_MEMBER_OF(type, ...) J2A_BY_FORM(J2A_TAKE_MEMBER_, type, __VA_ARGS__)
#define J2A_TAKE_MEMBER_ONE(element, name, n) \
    j2a_take_##element(&value->name, bytes); \
    bytes += j2a_size_##element;
#define J2A_TAKE_MEMBER_FIXED(element, name, n) \
    for (i = 0; i < (n); i++, bytes += j2a_size_##element) \
        j2a_take_##element(&value->name[i], bytes);
#define J2A_PUT_MEMBER(none, item) J2A_IF_FIELD(J2A_PUT_MEMBER_OF, item)
#define J2A_PUT_MEMBER_OF(type, ...) J2A_BY_FORM(J2A_PUT_MEMBER_, type, __VA_ARGS__)
#define J2A_PUT_MEMBER_ONE(element, name, n) \
    j2a_put_##element(bytes, j2a_as_##element(&value->name)); \
    bytes += j2a_size_##element;
#define J2A_PUT_MEMBER_FIXED(element, name, n) \
    for (i = 0; i < (n); i++, bytes += j2a_size_##element) \
        j2a_put_##element(bytes, j2a_as_##element(&value->name[i]));

/* The types come first, because the functions use them. */
#define J2A_ENUMERATOR(type, item) J2A_ENUMERATOR_(type, J2A_STRIP item)
#define J2A_ENUMERATOR_(type, ...) J2A_ENUMERATOR_OF(type, __VA_ARGS__)
#define J2A_ENUMERATOR_OF(type, value, number) type##_##value = number,
#define J2A_DEFINE_ENUM(name, integer, ...) \
    typedef j2a_c_##integer name; \
    enum { J2A_EACH(J2A_ENUMERATOR, J2A_ENUMERATOR, J2A_NOTHING, name, __VA_ARGS__, "") }; \
    J2A_ELEMENT_OF_C(name, j2a_c_##integer, j2a_size_##integer, 0) \
    J2A_INLINE void j2a_take_##name(name *value, const uint8_t *bytes) { \
        *value = j2a_get_##integer(bytes); \
    } \
    J2A_INLINE void j2a_put_##name(uint8_t *bytes, name value) { \
        j2a_put_##integer(bytes, value); \
    } \
    J2A_INLINE name j2a_as_##name(const name *value) { \
        return *value; \
    }
#define J2A_DEFINE_STRUCT(name, ...) \
    typedef struct { \
        J2A_EACH(J2A_MEMBER, J2A_MEMBER, J2A_NOTHING, ~, __VA_ARGS__, "") \
    } name; \
    typedef name j2a_c_##name; \
    typedef const name *j2a_arg_##name; \
    enum { \
        j2a_size_##name = 0 J2A_EACH(J2A_BYTES, J2A_BYTES, J2A_NOTHING, ~, __VA_ARGS__, ""), \
        j2a_bools_##name = 0 J2A_EACH(J2A_BOOLS, J2A_BOOLS, J2A_NOTHING, ~, __VA_ARGS__, "") \
    }; \
    J2A_INLINE void j2a_take_##name(name *value, const uint8_t *bytes) { \
        uint8_t i = 0; \
        J2A_EACH(J2A_TAKE_MEMBER, J2A_TAKE_MEMBER, J2A_NOTHING, ~, __VA_ARGS__, "") \
        (void)bytes; \
        (void)i; \
    } \
    J2A_INLINE void j2a_put_##name(uint8_t *bytes, const name *value) { \
        uint8_t i = 0; \
        J2A_EACH(J2A_PUT_MEMBER, J2A_PUT_MEMBER, J2A_NOTHING, ~, __VA_ARGS__, "") \
        (void)bytes; \
        (void)i; \
    } \
    J2A_INLINE const name *j2a_as_##name(const name *value) { \
        return value; \
    }
#define J2A_ENUM J2A_DEFINE_ENUM
#define J2A_STRUCT J2A_DEFINE_STRUCT
#define J2A_FUNCTION(name, result, ...)
#define J2A_BUFFER(name, type, length, text)
#define J2A_SIF(name, opcode, ...)
#define J2A_CALL(name, function)
#define J2A_MANY(name, function)
#include "functions.def"
#undef J2A_ENUM
#undef J2A_STRUCT
#undef J2A_FUNCTION
#undef J2A_BUFFER
#undef J2A_SIF
#undef J2A_CALL
#undef J2A_MANY

#define J2A_ENUM(name, integer, ...)
#define J2A_STRUCT(name, ...)
#define J2A_FUNCTION(name, result, ...) \
    J2A_RETURNS(result) app_##name J2A_PARAMETERS(~ \
        J2A_EACH(J2A_IN, J2A_IN, J2A_NOTHING, ~, __VA_ARGS__) \
        J2A_EACH(J2A_OUT, J2A_OUT, J2A_NOTHING, ~, J2A_OUTPUTS(result)));
#define J2A_BUFFER(name, type, length, text) extern J2A_PASTE1(j2a_c_, J2A_HEAD(type)) app_##name[length];
#define J2A_SIF(name, opcode, ...) \
    bool j2a_sif_##name J2A_PARAMETERS(~ J2A_EACH(J2A_IN, J2A_IN, J2A_NOTHING, ~, __VA_ARGS__));
#define J2A_CALL(name, function) J2A_DECLARE_CALL(function);
#define J2A_MANY(name, function) J2A_DECLARE_MANY(function);
#include "functions.def"
#undef J2A_ENUM
#undef J2A_STRUCT
#undef J2A_FUNCTION
#undef J2A_BUFFER
#undef J2A_SIF
#undef J2A_CALL
#undef J2A_MANY

#ifdef __cplusplus
}
#endif

#endif
