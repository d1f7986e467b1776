/* The function table in flash: one entry for each opcode, built-ins first. It is built from
 * functions.def by j2a_table.c, or by the macros of a2j.h. The order of the built-ins is the
 * protocol's; an option that is off moves the later ones down, except that opcode 0 stays reserved. */
#ifndef J2A_TABLE_H
#define J2A_TABLE_H

#include "j2a.h"

enum {
    J2A_KIND_CALL,
    J2A_KIND_MANY
};

#ifdef __cplusplus
extern "C" {
#endif

/* C99 allows no other common type for both kinds of functions; they are cast back before use. */
typedef void (*j2a_function)(void);

typedef struct {
    j2a_function function; /* none at opcode 0 without the map */
#if J2A_WITH_MAPPING
    const char *name;
#endif
#if J2A_WITH_MANY
    uint8_t kind;
#endif
} j2a_entry;

extern const j2a_entry j2a_functions[];
extern const uint8_t j2a_function_count; /* not in flash, so that link-time optimisation folds it */

/* key NUL value NUL ..., and one more NUL (an empty key) at the end */
extern const unsigned char j2a_properties[];

/* The number that a macro stands for, as text: J2A_PROPERTY("j2a.rxbuf", J2A_TEXT(J2A_RXBUF)). */
#define J2A_TEXT_(value) #value
#define J2A_TEXT(value) J2A_TEXT_(value)

/* What a device with less room than others says of it (J2A-LIMIT-006), whatever its application says. */
#if J2A_ROOM < J2A_MAX_PAYLOAD
#define J2A_PROPERTY_ROOM "j2a.room\0" J2A_TEXT(J2A_ROOM) "\0"
extern char j2a_room_is_not_decimal[sizeof J2A_TEXT(J2A_ROOM) == (J2A_ROOM < 100 ? 3 : 4) ? 1 : -1];
#else
#define J2A_PROPERTY_ROOM
#endif

/* The built-in functions in opcode order, as CALL(name on the wire, C function) or MANY(...). */
/* From capabilities.toml by `python -m j2a_spec.generate`. */
#if J2A_WITH_MAPPING
#define J2A_IF_MAPPING(text) text
#else
#define J2A_IF_MAPPING(text)
#endif
#if J2A_WITH_MANY
#define J2A_IF_MANY(text) text
#else
#define J2A_IF_MANY(text)
#endif
#if J2A_WITH_PROPERTIES
#define J2A_IF_PROPERTIES(text) text
#else
#define J2A_IF_PROPERTIES(text)
#endif
#if J2A_WITH_DEBUG
#define J2A_IF_DEBUG(text) text
#else
#define J2A_IF_DEBUG(text)
#endif
#define J2A_BUILTINS(CALL, MANY) \
    J2A_IF_MAPPING(CALL(a2jGetMapping, j2a_get_mapping)) \
    J2A_IF_MANY(CALL(a2jMany, j2a_many)) \
    J2A_IF_PROPERTIES(MANY(a2jGetProperties, j2a_get_properties)) \
    J2A_IF_DEBUG(CALL(a2jDebug, j2a_get_debug)) \
    CALL(a2jEcho, j2a_echo) \
    J2A_IF_MANY(MANY(a2jEchoMany, j2a_echo_many))
/* End of what is generated. */

#define J2A_DECLARED_CALL(name, function) J2A_DECLARE_CALL(function);
#define J2A_DECLARED_MANY(name, function) J2A_DECLARE_MANY(function);
J2A_BUILTINS(J2A_DECLARED_CALL, J2A_DECLARED_MANY)

/* Bytes of the names in the map. */
#define J2A_SIZE(name, function) + sizeof #name
#define J2A_BUILTIN_SIZE (0 J2A_BUILTINS(J2A_SIZE, J2A_SIZE))

/* Without a2jMany there is but one kind. */
#if J2A_WITH_MANY
#define J2A_OF_KIND(kind) , kind
#else
#define J2A_OF_KIND(kind)
#endif

/* A name that comes twice declares an enumerator twice, an empty one an array of negative size. */
#if J2A_WITH_MAPPING
#define J2A_NAME(function, text, enumerator) \
    enum { enumerator }; \
    extern char j2a_name_is_empty[sizeof text > 1 ? 1 : -1]; \
    static const char J2A_FLASH function##_map[] = text;
#define J2A_ENTRY(function, kind) {(j2a_function)(function), function##_map J2A_OF_KIND(kind)}
#define J2A_RESERVED
#else
#define J2A_NAME(function, text, enumerator)
#define J2A_ENTRY(function, kind) {(j2a_function)(function) J2A_OF_KIND(kind)}
#define J2A_RESERVED {0 J2A_OF_KIND(J2A_KIND_CALL)},
#endif
#define J2A_NAMED(function, name) J2A_NAME(function, #name, j2a_name_##name)

/* What the application's table begins with. Each entry ends in a comma, also the last one of the table. */
#define J2A_BUILTIN_NAME(name, function) J2A_NAMED(function, name)
#define J2A_BUILTIN_NAMES J2A_BUILTINS(J2A_BUILTIN_NAME, J2A_BUILTIN_NAME)
#define J2A_CALL_ENTRY(name, function) J2A_ENTRY(function, J2A_KIND_CALL),
#define J2A_MANY_ENTRY(name, function) J2A_ENTRY(function, J2A_KIND_MANY),
#define J2A_BUILTIN_ENTRIES J2A_RESERVED J2A_BUILTINS(J2A_CALL_ENTRY, J2A_MANY_ENTRY)

#ifdef __cplusplus
}
#endif

#endif
