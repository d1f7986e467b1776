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

J2A_DECLARE_CALL(j2a_get_mapping);
J2A_DECLARE_CALL(j2a_many);
J2A_DECLARE_CALL(j2a_get_debug);
J2A_DECLARE_CALL(j2a_echo);
J2A_DECLARE_MANY(j2a_get_properties);
J2A_DECLARE_MANY(j2a_echo_many);

/* A name that comes twice declares an enumerator twice, an empty one an array of negative size. */
#if J2A_WITH_MAPPING
#define J2A_NAME(function, text, enumerator) \
    enum { enumerator }; \
    extern char j2a_name_is_empty[sizeof text > 1 ? 1 : -1]; \
    static const char J2A_FLASH function##_map[] = text;
#define J2A_ENTRY(function, kind) {(j2a_function)(function), function##_map J2A_OF_KIND(kind)}
#define J2A_ENTRY_0 J2A_ENTRY(j2a_get_mapping, J2A_KIND_CALL)
#else
#define J2A_NAME(function, text, enumerator)
#define J2A_ENTRY(function, kind) {(j2a_function)(function) J2A_OF_KIND(kind)}
#define J2A_ENTRY_0 {0 J2A_OF_KIND(J2A_KIND_CALL)}
#endif
#define J2A_NAMED(function, name) J2A_NAME(function, #name, j2a_name_##name)

/* Without a2jMany there is but one kind. */
#if J2A_WITH_MANY
#define J2A_OF_KIND(kind) , kind
#define J2A_NAME_MANY J2A_NAMED(j2a_many, a2jMany)
#define J2A_ENTRY_MANY , J2A_ENTRY(j2a_many, J2A_KIND_CALL)
#define J2A_NAME_ECHO_MANY J2A_NAMED(j2a_echo_many, a2jEchoMany)
#define J2A_ENTRY_ECHO_MANY , J2A_ENTRY(j2a_echo_many, J2A_KIND_MANY)
#else
#define J2A_OF_KIND(kind)
#define J2A_NAME_MANY
#define J2A_ENTRY_MANY
#define J2A_NAME_ECHO_MANY
#define J2A_ENTRY_ECHO_MANY
#endif

#if J2A_WITH_PROPERTIES
#define J2A_NAME_PROPERTIES J2A_NAMED(j2a_get_properties, a2jGetProperties)
#define J2A_ENTRY_PROPERTIES , J2A_ENTRY(j2a_get_properties, J2A_KIND_MANY)
#else
#define J2A_NAME_PROPERTIES
#define J2A_ENTRY_PROPERTIES
#endif

#if J2A_WITH_DEBUG
#define J2A_NAME_DEBUG J2A_NAMED(j2a_get_debug, a2jDebug)
#define J2A_ENTRY_DEBUG , J2A_ENTRY(j2a_get_debug, J2A_KIND_CALL)
#else
#define J2A_NAME_DEBUG
#define J2A_ENTRY_DEBUG
#endif

#define J2A_BUILTIN_NAMES \
    J2A_NAMED(j2a_get_mapping, a2jGetMapping) \
    J2A_NAME_MANY \
    J2A_NAME_PROPERTIES \
    J2A_NAME_DEBUG \
    J2A_NAMED(j2a_echo, a2jEcho) \
    J2A_NAME_ECHO_MANY

#define J2A_BUILTIN_ENTRIES \
    J2A_ENTRY_0 \
    J2A_ENTRY_MANY \
    J2A_ENTRY_PROPERTIES \
    J2A_ENTRY_DEBUG, \
    J2A_ENTRY(j2a_echo, J2A_KIND_CALL) \
    J2A_ENTRY_ECHO_MANY

#ifdef __cplusplus
}
#endif

#endif
