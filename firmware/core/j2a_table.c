/* Builds the function table, the typed functions and the properties of an application from its functions.def
 * (see j2a_functions.h) and its properties.def, lines of
 *   J2A_PROPERTY("key", "value") */
#include "j2a_functions.h"
#include "j2a_table.h"

/* J2A_IF_MANY: nobody could call a function of kind many without a2jMany, so it gets no opcode then. */

/* ------------------------------------------------------------------------- typed functions ------ */

#ifdef __AVR__
#define j2a_get_u32 j2a_load_u32
#define j2a_put_u32 j2a_store_u32
#endif

/* Of a local array as long as a payload: the stack of an 8051 has 256 bytes. No typed function runs twice at a time. */
#ifdef __SDCC
#define J2A_LARGE static
#else
#define J2A_LARGE
#endif

/* Of an open end: bytes of an element, and the most elements; both 0 without one. */
#define J2A_STEP(none, item) J2A_IF_FIELD(J2A_STEP_OF, item)
#define J2A_STEP_OF(type, ...) J2A_BY_FORM(J2A_STEP_, type, __VA_ARGS__)
#define J2A_STEP_ONE(element, name, n)
#define J2A_STEP_FIXED(element, name, n)
#define J2A_STEP_OPEN(element, name, n) + 1
#define J2A_STEP_LIST(element, name, n) + (int)j2a_size_##element
#define J2A_MOST(none, item) J2A_IF_FIELD(J2A_MOST_OF, item)
#define J2A_MOST_OF(type, ...) J2A_BY_FORM(J2A_MOST_, type, __VA_ARGS__)
#define J2A_MOST_ONE(element, name, n)
#define J2A_MOST_FIXED(element, name, n)
#define J2A_MOST_OPEN(element, name, n) + (n)
#define J2A_MOST_LIST(element, name, n) + (n)

/* Takes the parameters out of the request. */
#define J2A_UNPACK(none, item) J2A_IF_FIELD(J2A_UNPACK_OF, item)
#define J2A_UNPACK_OF(type, ...) J2A_BY_FORM(J2A_UNPACK_, type, __VA_ARGS__)
#define J2A_UNPACK_ONE(element, name, n) \
    j2a_c_##element in_##name; \
    j2a_take_##element(&in_##name, next); \
    next += j2a_size_##element;
#define J2A_UNPACK_FIXED(element, name, n) \
    j2a_c_##element in_##name[n]; \
    for (i = 0; i < (n); i++, next += j2a_size_##element) \
        j2a_take_##element(&in_##name[i], next);
#define J2A_UNPACK_OPEN(element, name, n) \
    const j2a_c_##element *const in_##name = (const j2a_c_##element *)next; \
    const uint8_t length_of_##name = (uint8_t)(*length - request_size);
#define J2A_UNPACK_LIST(element, name, n) \
    J2A_LARGE j2a_c_##element in_##name[J2A_ROOM / j2a_size_##element + 1]; /* C has no empty arrays */ \
    const uint8_t length_of_##name = (uint8_t)((*length - request_size) / j2a_size_##element); \
    for (i = 0; i < length_of_##name; i++, next += j2a_size_##element) \
        j2a_take_##element(&in_##name[i], next);

#define J2A_PASS_IN(none, item) J2A_IF_FIELD(J2A_PASS_IN_OF, item)
#define J2A_PASS_IN_OF(type, ...) J2A_BY_FORM(J2A_PASS_IN_, type, __VA_ARGS__)
#define J2A_PASS_IN_ONE(element, name, n) , j2a_as_##element(&in_##name)
#define J2A_PASS_IN_FIXED(element, name, n) , in_##name
#define J2A_PASS_IN_OPEN(element, name, n) , in_##name, length_of_##name
#define J2A_PASS_IN_LIST(element, name, n) , in_##name, length_of_##name

/* Where the function leaves its results. What is open begins as room behind the request, for bytes. */
#define J2A_HOLD(none, item) J2A_IF_FIELD(J2A_HOLD_OF, item)
#define J2A_HOLD_OF(type, ...) J2A_BY_FORM(J2A_HOLD_, type, __VA_ARGS__)
#define J2A_HOLD_ONE(element, name, n) j2a_c_##element out_##name = {0};
#define J2A_HOLD_FIXED(element, name, n) j2a_c_##element out_##name[n] = {0};
#define J2A_HOLD_OPEN(element, name, n) \
    j2a_c_##element *out_##name = (j2a_c_##element *)*payload + *length; \
    uint8_t size_of_##name = (uint8_t)(J2A_ROOM - *length);
#define J2A_HOLD_LIST(element, name, n) \
    j2a_c_##element *out_##name = 0; \
    uint8_t size_of_##name = 0;

#define J2A_PASS_OUT(none, item) J2A_IF_FIELD(J2A_PASS_OUT_OF, item)
#define J2A_PASS_OUT_OF(type, ...) J2A_BY_FORM(J2A_PASS_OUT_, type, __VA_ARGS__)
#define J2A_PASS_OUT_ONE(element, name, n) , &out_##name
#define J2A_PASS_OUT_FIXED(element, name, n) , out_##name
#define J2A_PASS_OUT_OPEN(element, name, n) , &out_##name, &size_of_##name
#define J2A_PASS_OUT_LIST(element, name, n) , &out_##name, &size_of_##name

/* Puts the results into the reply: what is open first, because it may be in bytes that the others take. */
#define J2A_APPEND(none, item) J2A_IF_FIELD(J2A_APPEND_OF, item)
#define J2A_APPEND_OF(type, ...) J2A_BY_FORM(J2A_APPEND_, type, __VA_ARGS__)
#define J2A_APPEND_ONE(element, name, n)
#define J2A_APPEND_FIXED(element, name, n)
#define J2A_APPEND_OPEN(element, name, n) \
    size = (uint8_t)(size + j2a_leave(payload, reply_size, (uint8_t *)out_##name, size_of_##name, n));
#define J2A_APPEND_LIST(element, name, n) \
    if (size_of_##name > (J2A_ROOM - reply_size) / j2a_size_##element) \
        j2a_fail(J2A_RET_FAILED); \
    for (i = 0; j2a_failure == 0 && i < size_of_##name; i++, size = (uint8_t)(size + j2a_size_##element)) \
        j2a_put_##element(*payload + size, j2a_as_##element(&out_##name[i]));
#define J2A_LEAVE(none, item) J2A_IF_FIELD(J2A_LEAVE_OF, item)
#define J2A_LEAVE_OF(type, ...) J2A_BY_FORM(J2A_LEAVE_, type, __VA_ARGS__)
#define J2A_LEAVE_ONE(element, name, n) \
    j2a_put_##element(to, j2a_as_##element(&out_##name)); \
    to += j2a_size_##element;
#define J2A_LEAVE_FIXED(element, name, n) \
    for (i = 0; i < (n); i++, to += j2a_size_##element) \
        j2a_put_##element(to, j2a_as_##element(&out_##name[i]));
#define J2A_LEAVE_OPEN(element, name, n)
#define J2A_LEAVE_LIST(element, name, n)

/* A result alone is what the function returns. */
#define J2A_RESULT(result) J2A_BY_SHAPE(J2A_RESULT_, result)
#define J2A_RESULT_VOID(r)
#define J2A_RESULT_ONE(r) const J2A_PASTE1(j2a_c_, J2A_HEAD(r)) out_result =
#define J2A_RESULT_FIXED(r)
#define J2A_RESULT_OPEN(r)
#define J2A_RESULT_LIST(r)
#define J2A_RESULT_NAMED(r)
#define J2A_RETURNED(result) J2A_BY_SHAPE(J2A_RETURNED_, result)
#define J2A_RETURNED_VOID(r) ""
#define J2A_RETURNED_ONE(r) (J2A_HEAD(r), result), ""
#define J2A_RETURNED_FIXED(r) ""
#define J2A_RETURNED_OPEN(r) ""
#define J2A_RETURNED_LIST(r) ""
#define J2A_RETURNED_NAMED(r) ""

#define J2A_FUNCTION(name, result, ...) \
    static uint8_t j2a_call_##name(uint8_t *const length, uint8_t **const payload) { \
        enum { \
            request_size = 0 J2A_EACH(J2A_BYTES, J2A_BYTES, J2A_NOTHING, ~, __VA_ARGS__), \
            step = 0 J2A_EACH(J2A_STEP, J2A_STEP, J2A_NOTHING, ~, __VA_ARGS__), \
            most = 0 J2A_EACH(J2A_MOST, J2A_MOST, J2A_NOTHING, ~, __VA_ARGS__), \
            reply_size = 0 J2A_EACH(J2A_BYTES, J2A_BYTES, J2A_NOTHING, ~, J2A_OUTPUTS(result)) \
                J2A_EACH(J2A_BYTES, J2A_BYTES, J2A_NOTHING, ~, J2A_RETURNED(result)), \
            no_payload_is_longer_than_J2A_ROOM = 1 / (request_size <= J2A_ROOM && reply_size <= J2A_ROOM) \
        }; \
        const uint8_t *next = *payload; \
        uint8_t *to; \
        uint8_t size = reply_size; \
        uint8_t i = 0; \
        if (!(step == 0 ? j2a_begin(length, request_size) \
                        : j2a_begin_open(length, request_size, step == 0 ? 1 : step, most))) \
            return J2A_RET_FAILED; \
        J2A_EACH(J2A_UNPACK, J2A_UNPACK, J2A_NOTHING, ~, __VA_ARGS__) \
        J2A_EACH(J2A_HOLD, J2A_HOLD, J2A_NOTHING, ~, J2A_OUTPUTS(result)) \
        J2A_RESULT(result) app_##name J2A_ARGUMENTS(~ \
            J2A_EACH(J2A_PASS_IN, J2A_PASS_IN, J2A_NOTHING, ~, __VA_ARGS__) \
            J2A_EACH(J2A_PASS_OUT, J2A_PASS_OUT, J2A_NOTHING, ~, J2A_OUTPUTS(result))); \
        J2A_EACH(J2A_APPEND, J2A_APPEND, J2A_NOTHING, ~, J2A_OUTPUTS(result)) \
        to = *payload; \
        J2A_EACH(J2A_LEAVE, J2A_LEAVE, J2A_NOTHING, ~, J2A_OUTPUTS(result)) \
        J2A_EACH(J2A_LEAVE, J2A_LEAVE, J2A_NOTHING, ~, J2A_RETURNED(result)) \
        (void)next; \
        (void)to; \
        (void)i; \
        return j2a_end(length, size); \
    }

/* Both the text and the length are the C preprocessor's, so the length must be what it looks like. */
#define J2A_DIGITS(n) ((n) < 10 ? 2 : (n) < 100 ? 3 : (n) < 1000 ? 4 : (n) < 10000 ? 5 : 6)
#define J2A_BUFFER(name, type, count, text) \
    extern char j2a_length_of_##name##_is_no_number_of_1_to_65535[ \
        (count) >= 1 && (count) <= 65535 && sizeof J2A_TEXT(count) == J2A_DIGITS(count) ? 1 : -1]; \
    J2A_PASTE1(j2a_c_, J2A_HEAD(type)) app_##name[count]; \
    J2A_IF_MANY( \
        static uint8_t j2a_buffer_##name(bool *is_last, bool is_write, uint32_t *const offset, \
                                         uint8_t *const length, uint8_t **const data) { \
            return j2a_buffer((uint8_t *)app_##name, sizeof app_##name, sizeof app_##name[0], is_last, is_write, \
                              *offset, length, *data); \
        })

/* Puts the fields of a SIF into its payload. */
#define J2A_SEND(none, item) J2A_IF_FIELD(J2A_SEND_OF, item)
#define J2A_SEND_OF(type, ...) J2A_BY_FORM(J2A_SEND_, type, __VA_ARGS__)
#define J2A_SEND_ONE(element, name, n) \
    j2a_put_##element(to, in_##name); \
    to += j2a_size_##element;
#define J2A_SEND_FIXED(element, name, n) \
    for (i = 0; i < (n); i++, to += j2a_size_##element) \
        j2a_put_##element(to, j2a_as_##element(&in_##name[i]));
#define J2A_SEND_OPEN(element, name, n) \
    to = j2a_put_open(to, (const uint8_t *)in_##name, length_of_##name, n, (uint8_t)(J2A_MAX_PAYLOAD - fixed_size)); \
    if (to == 0) \
        return false;
#define J2A_SEND_LIST(element, name, n) \
    if (length_of_##name > (J2A_MAX_PAYLOAD - fixed_size) / j2a_size_##element) \
        return false; \
    for (i = 0; i < length_of_##name; i++, to += j2a_size_##element) \
        j2a_put_##element(to, j2a_as_##element(&in_##name[i]));
#define J2A_UNUSED(none, item) J2A_IF_FIELD(J2A_UNUSED_OF, item)
#define J2A_UNUSED_OF(type, ...) J2A_BY_FORM(J2A_UNUSED_, type, __VA_ARGS__)
#define J2A_UNUSED_ONE(element, name, n) (void)in_##name;
#define J2A_UNUSED_FIXED(element, name, n) (void)in_##name;
#define J2A_UNUSED_OPEN(element, name, n) (void)in_##name, (void)length_of_##name;
#define J2A_UNUSED_LIST(element, name, n) (void)in_##name, (void)length_of_##name;

#if J2A_WITH_SIF
#define J2A_SIF(name, opcode, ...) \
    bool j2a_sif_##name J2A_PARAMETERS(~ J2A_EACH(J2A_IN, J2A_IN, J2A_NOTHING, ~, __VA_ARGS__)) { \
        enum { \
            fixed_size = 0 J2A_EACH(J2A_BYTES, J2A_BYTES, J2A_NOTHING, ~, __VA_ARGS__), \
            is_open = 0 J2A_EACH(J2A_STEP, J2A_STEP, J2A_NOTHING, ~, __VA_ARGS__), \
            no_payload_is_longer_than_255 = 1 / (fixed_size <= (int)J2A_MAX_PAYLOAD), \
            opcode_255_is_that_of_the_boot_SIF = 1 / !(J2A_WITH_BOOT && (opcode) == J2A_BOOT) \
        }; \
        J2A_LARGE uint8_t payload[is_open ? J2A_MAX_PAYLOAD : fixed_size + 1]; /* C has no empty arrays */ \
        uint8_t *to = payload; \
        uint8_t i = 0; \
        payload[0] = 0; \
        J2A_EACH(J2A_SEND, J2A_SEND, J2A_NOTHING, ~, __VA_ARGS__) \
        (void)i; \
        j2a_send_sif(opcode, (uint8_t)(to - payload), payload); \
        return true; \
    }
#else
#define J2A_SIF(name, opcode, ...) \
    bool j2a_sif_##name J2A_PARAMETERS(~ J2A_EACH(J2A_IN, J2A_IN, J2A_NOTHING, ~, __VA_ARGS__)) { \
        J2A_EACH(J2A_UNUSED, J2A_UNUSED, J2A_NOTHING, ~, __VA_ARGS__) \
        return false; \
    }
#endif
#define J2A_ENUM(name, integer, ...)
#define J2A_STRUCT(name, ...)
#define J2A_CALL(name, function)
#define J2A_MANY(name, function)
#include "functions.def"
#undef J2A_FUNCTION
#undef J2A_BUFFER
#undef J2A_SIF
#undef J2A_CALL
#undef J2A_MANY

#undef j2a_get_u32
#undef j2a_put_u32

/* ------------------------------------------------------------------------- names and interface ------ */

#define J2A_SIF(name, opcode, ...)
#if J2A_WITH_MAPPING && !J2A_WITH_INTERFACE
/* The map must fit into one frame: a negative array size stops the build when it does not. */
#define J2A_FUNCTION(name, result, ...) + sizeof #name
#define J2A_BUFFER(name, type, count, text) J2A_IF_MANY(+ sizeof #name)
#define J2A_CALL(name, function) + sizeof #name
#define J2A_MANY(name, function) J2A_IF_MANY(+ sizeof #name)
typedef char j2a_names_longer_than_a_payload[
    J2A_BUILTIN_SIZE
#include "functions.def"
    <= J2A_ROOM ? 1 : -1];
#undef J2A_FUNCTION
#undef J2A_BUFFER
#undef J2A_CALL
#undef J2A_MANY
#endif

#if J2A_WITH_INTERFACE
/* The lines of SPEC.md, section 20, without the line feed; those of definitions are in j2a_fields.h. */
#define J2A_RESULT_TEXT(result) J2A_BY_SHAPE(J2A_RESULT_TEXT_, result)
#define J2A_RESULT_TEXT_VOID(r)
#define J2A_RESULT_TEXT_ONE(r) J2A_TYPE_TEXT(r)
#define J2A_RESULT_TEXT_FIXED(r) J2A_TYPE_TEXT(r)
#define J2A_RESULT_TEXT_OPEN(r) J2A_TYPE_TEXT(r)
#define J2A_RESULT_TEXT_LIST(r) J2A_TYPE_TEXT(r)
#define J2A_RESULT_TEXT_NAMED(r) " " J2A_FIELD_LIST(J2A_STRIP r, "")
#define J2A_TYPE_TEXT(r) " " J2A_SPELL(J2A_HEAD(r)) J2A_PASTE6(J2A_TYPE_UNIT_, J2A_IN_PARENTHESES(r))(r)
#define J2A_TYPE_UNIT_0(r)
#define J2A_TYPE_UNIT_1(r) J2A_UNIT_TEXT r
#define J2A_FLAG(none, item) J2A_PASTE6(J2A_FLAG_, J2A_IN_PARENTHESES(item))(item)
#define J2A_FLAG_0(flag) J2A_PASTE5(J2A_FLAG_, flag)
#define J2A_FLAG_1(field)
#define J2A_FLAG_idempotent " !idempotent"
#define J2A_FLAG_slow(time_ms) " !slow(" J2A_STRING(time_ms) ")"
#define J2A_DOC(none, text) " # " text
#define J2A_FUNCTION_TEXT(name, result, ...) \
    #name J2A_FIELD_LIST(__VA_ARGS__) J2A_RESULT_TEXT(result) J2A_EACH(J2A_FLAG, J2A_FLAG, J2A_DOC, ~, __VA_ARGS__)
#define J2A_BUFFER_TEXT(name, type, count, text) #name " many " J2A_ARRAY_TEXT(type, count) " # " text
#define J2A_ARRAY_TEXT(type, count) J2A_STRING(J2A_HEAD(type)) "[" J2A_STRING(count) "]" \
    J2A_PASTE6(J2A_TYPE_UNIT_, J2A_IN_PARENTHESES(type))(type)
#else
#define J2A_FUNCTION_TEXT(name, result, ...) #name
#define J2A_BUFFER_TEXT(name, type, count, text) #name
#endif

#define J2A_FUNCTION(name, result, ...) \
    J2A_NAME(j2a_call_##name, J2A_FUNCTION_TEXT(name, result, __VA_ARGS__), j2a_name_##name)
#define J2A_BUFFER(name, type, count, text) \
    J2A_IF_MANY(J2A_NAME(j2a_buffer_##name, J2A_BUFFER_TEXT(name, type, count, text), j2a_name_##name))
#define J2A_CALL(name, function) J2A_NAME(function, #name, j2a_name_##name)
#define J2A_MANY(name, function) J2A_IF_MANY(J2A_NAME(function, #name, j2a_name_##name))
#include "functions.def"
#undef J2A_FUNCTION
#undef J2A_BUFFER
#undef J2A_CALL
#undef J2A_MANY

J2A_TABLE_BEGIN
#define J2A_FUNCTION(name, result, ...) J2A_CALL_ENTRY(name, j2a_call_##name)
#define J2A_BUFFER(name, type, count, text) J2A_IF_MANY(J2A_MANY_ENTRY(name, j2a_buffer_##name))
#define J2A_CALL(name, function) J2A_CALL_ENTRY(name, function)
#define J2A_MANY(name, function) J2A_IF_MANY(J2A_MANY_ENTRY(name, function))
#include "functions.def"
J2A_TABLE_END
#undef J2A_ENUM
#undef J2A_STRUCT
#undef J2A_FUNCTION
#undef J2A_BUFFER
#undef J2A_SIF
#undef J2A_CALL
#undef J2A_MANY

#if J2A_WITH_INTERFACE
#define J2A_ENUM J2A_ENUM_TEXT
#define J2A_STRUCT J2A_STRUCT_TEXT
#if J2A_WITH_SIF
#define J2A_SIF(name, opcode, ...) "sif " #name " " J2A_STRING(opcode) " " J2A_FIELD_LIST(__VA_ARGS__) \
    J2A_EACH(J2A_NOTHING, J2A_NOTHING, J2A_DOC, ~, __VA_ARGS__) "\n"
#else
#define J2A_SIF(name, opcode, ...)
#endif
#define J2A_FUNCTION(name, result, ...)
#define J2A_BUFFER(name, type, count, text)
#define J2A_CALL(name, function)
#define J2A_MANY(name, function)
static const char J2A_FLASH definitions[] = ""
#include "functions.def"
    ;
const char *j2a_definitions(void) {
    return definitions;
}
#endif

/* ------------------------------------------------------------------------- properties ------ */

#if J2A_WITH_PROPERTIES
/* An empty key would end the list, and no host reads one with a key that comes twice. */
#if defined __GNUC__ && !defined __FRAMAC__ /* the proof's front end has no such constants */
#define J2A_IS_CAPS(key) (sizeof(J2A_PROPERTY_CAPS "") > 1 && !__builtin_strcmp(key, "j2a.caps"))
#else
#define J2A_IS_CAPS(key) 0
#endif
#define J2A_PROPERTY(key, value) \
    extern char j2a_property_is_empty[sizeof key > 1 && sizeof value > 1 ? 1 : -1]; \
    extern char j2a_caps_is_there_already[J2A_IS_CAPS(key) ? -1 : 1];
#include "properties.def"
#undef J2A_PROPERTY
#define J2A_PROPERTY(key, value) key "\0" value "\0"
const unsigned char J2A_FLASH j2a_properties[] = J2A_PROPERTY_ROOM J2A_PROPERTY_CAPS
#ifdef J2A_ADD_SPEC /* by the build, for a properties.def without it: it belongs to each device */
    J2A_PROPERTY("j2a.spec", J2A_SPEC_VERSION)
#endif
#include "properties.def"
    "";
#endif
