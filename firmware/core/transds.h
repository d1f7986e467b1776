/* Sensors and actuators of an application: what its transds.def lists, and the thesis' two functions (listing 9.3).
 * In: values from the callbacks of drivers, and settings from the host. Out: sample SIFs, values for actuators.
 * Lines of transds.def, in which what is in brackets may be missing:
 *   SENSOR(name, id, prefix, model, channels, type, na, [(key, value), ...] ["text"])
 *   ACTUATOR(name, id, prefix, model, channels, type, safe, [(key, value), ...] ["text"])
 *   J2A_STRUCT(...), J2A_ENUM(...)    types, as in functions.def
 * SENSOR_EX is another name for SENSOR. Each line may end with a backslash, and all of them may be a macro SENSORS, as
 * in the thesis (listing 9.2). docs/transducers.md says what types and keys there are.
 * A driver has the functions that its prefix begins:
 *   void PREFIX_set_cb(void (*)(uint8_t channel, TYPE value));   a sensor: takes what it calls with each value
 *   void PREFIX_trigger(void);                                   a sensor with the key trigger: measures once
 *   void PREFIX_set(uint8_t channel, TYPE value);                an actuator
 * A structure is passed by pointer. Rule: the callback of a sensor may be called from one interrupt or from the main
 * context, but not from two that interrupt each other. */
#ifndef TRANSDS_H
#define TRANSDS_H

#include "j2a_functions.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Gives the drivers their callbacks. Called once, behind j2a_port_init(). */
void transds_init(void);

/* Sends what sensors have measured, at most one SIF in each call, and sets actuators whose time has come. Called in
 * each turn of the main loop, beside j2a_task(). */
void transds_process(void);

/* Types of values, in C and in a descriptor: those of C as the thesis has them, besides those of functions.def. */
#define J2A_VALUE_TYPE(type) J2A_SECOND(J2A_PASTE1(J2A_VALUE_TYPE_, type), type)
#define J2A_VALUE_TYPE_int8_t ~, i8
#define J2A_VALUE_TYPE_int16_t ~, i16
#define J2A_VALUE_TYPE_int32_t ~, i32
#define J2A_VALUE_TYPE_int64_t ~, i64
#define J2A_VALUE_TYPE_uint8_t ~, u8
#define J2A_VALUE_TYPE_uint16_t ~, u16
#define J2A_VALUE_TYPE_uint32_t ~, u32
#define J2A_VALUE_TYPE_uint64_t ~, u64
#define J2A_VALUE_TYPE_float ~, f32
#if DBL_MANT_DIG == 53
#define J2A_VALUE_TYPE_double ~, f64
#else
#define J2A_VALUE_TYPE_double ~, f32
#endif

/* The parameter (channel, value) of a callback. */
#define J2A_VALUE_OF(type) (uint8_t channel J2A_IN(~, (type, value)))

/* Of each type with a name whether it has raw values, as enumerations have, and the element that holds one. */
#define J2A_DEFINE_RAW(name, has_raw, element) \
    enum { j2a_has_raw_##name = has_raw }; \
    typedef j2a_c_##element j2a_c_raw_##name; \
    J2A_INLINE void j2a_put_raw_##name(uint8_t *bytes, j2a_c_##element value) { \
        j2a_put_##element(bytes, value); \
    }

/* The functions of the drivers (listing 8.1). A driver may come twice, for two sensors of one kind. */
#define J2A_ENUM(name, integer, ...) \
    J2A_DEFINE_ENUM(name, integer, __VA_ARGS__) \
    J2A_DEFINE_RAW(name, 1, integer)
#define J2A_STRUCT(name, ...) \
    J2A_DEFINE_STRUCT(name, __VA_ARGS__) \
    J2A_DEFINE_RAW(name, 0, u8)
#define J2A_TRANSD(KIND, name, id, prefix, model, channels, type, na, ...)
#include "j2a_transds_list.h"
#undef J2A_TRANSD
#undef J2A_STRUCT
#undef J2A_ENUM

#define J2A_ENUM(name, integer, ...)
#define J2A_STRUCT(name, ...)
#define J2A_TRANSD(KIND, name, id, prefix, model, channels, type, na, ...) \
    J2A_DRIVER_##KIND(prefix, J2A_VALUE_TYPE(type)) \
    J2A_EACH(J2A_DRIVER_ITEM, J2A_DRIVER_ITEM, J2A_NOTHING, prefix, __VA_ARGS__)
#define J2A_DRIVER_SENSOR(prefix, type) void prefix##_set_cb(void (*callback)J2A_VALUE_OF(type));
#define J2A_DRIVER_ACTUATOR(prefix, type) void prefix##_set J2A_VALUE_OF(type);
#define J2A_DRIVER_ITEM(prefix, item) J2A_PASTE6(J2A_DRIVER_ITEM_, J2A_IN_PARENTHESES(item))(prefix, item)
#define J2A_DRIVER_ITEM_0(prefix, item)
#define J2A_DRIVER_ITEM_1(prefix, item) J2A_APPLY(J2A_DRIVER_KEY, prefix, J2A_FIRST item)
#define J2A_DRIVER_KEY(prefix, key) J2A_INNER_SECOND(J2A_DRIVER_KEY_##key, J2A_NO_DRIVER)(prefix)
#define J2A_DRIVER_KEY_trigger ~, J2A_TRIGGER_DRIVER
#define J2A_TRIGGER_DRIVER(prefix) void prefix##_trigger(void);
#define J2A_NO_DRIVER(prefix)
#include "j2a_transds_list.h"
#undef J2A_TRANSD
#undef J2A_STRUCT
#undef J2A_ENUM

#ifdef __cplusplus
}
#endif

#endif
