/* The function tables in flash, with one entry for each opcode: first that of the built-in functions, which
 * is the core's, then the application's. The latter is made of functions.def by j2a_table.c, of a list by
 * j2a_lists.h, or by the macros of a2j.h. The order of the built-ins is the protocol's; an option that is off
 * moves the later ones down, except that opcode 0 stays reserved. */
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
    const char *name; /* and what follows it in the line of the interface */
#endif
#if J2A_WITH_MANY
    uint8_t kind;
#endif
} j2a_entry;

extern const j2a_entry j2a_builtins[];   /* J2A_BUILTIN_COUNT of them */
extern const j2a_entry j2a_functions[];  /* the application's */
#if J2A_WITH_INTERFACE
const char *j2a_definitions(void);       /* of types and SIFs, in flash, each with a line feed */
#endif
extern const uint8_t j2a_function_count; /* of both; not in flash, so that link-time optimisation folds it */

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

/* The parts that are built in: what the core announces of them (J2A-CAP-001), of the first one without a space, and
 * the built-in functions in opcode order, as CALL(name on the wire, C function) or MANY(...). */
/* From capabilities.toml by `python -m j2a_spec.generate`. */
#if !J2A_WITH_INTERFACE
#define J2A_TOKEN_INTERFACE
#else
#define J2A_TOKEN_INTERFACE "interface"
#endif
#if !J2A_WITH_BOOT
#define J2A_TOKEN_BOOT
#elif J2A_WITH_INTERFACE
#define J2A_TOKEN_BOOT " boot"
#else
#define J2A_TOKEN_BOOT "boot"
#endif
#if !J2A_WITH_TRANSDUCERS
#define J2A_TOKEN_TRANSDUCERS
#elif J2A_WITH_INTERFACE || J2A_WITH_BOOT
#define J2A_TOKEN_TRANSDUCERS " transducers"
#else
#define J2A_TOKEN_TRANSDUCERS "transducers"
#endif
#if !J2A_WITH_SYNC
#define J2A_TOKEN_CLOCK
#elif J2A_WITH_INTERFACE || J2A_WITH_BOOT || J2A_WITH_TRANSDUCERS
#define J2A_TOKEN_CLOCK " clock"
#else
#define J2A_TOKEN_CLOCK "clock"
#endif
#if J2A_WITH_INTERFACE || J2A_WITH_BOOT || J2A_WITH_TRANSDUCERS || J2A_WITH_SYNC
#define J2A_PROPERTY_CAPS "j2a.caps\0" J2A_TOKEN_INTERFACE J2A_TOKEN_BOOT J2A_TOKEN_TRANSDUCERS \
     J2A_TOKEN_CLOCK "\0"
#else
#define J2A_PROPERTY_CAPS
#endif
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
#if J2A_WITH_INTERFACE
#define J2A_IF_INTERFACE(text) text
#else
#define J2A_IF_INTERFACE(text)
#endif
#if J2A_WITH_TRANSDUCERS
#define J2A_IF_TRANSDUCERS(text) text
#else
#define J2A_IF_TRANSDUCERS(text)
#endif
#if J2A_WITH_SYNC
#define J2A_IF_CLOCK(text) text
#else
#define J2A_IF_CLOCK(text)
#endif
#define J2A_BUILTINS(CALL, MANY) \
    J2A_IF_MAPPING(CALL(a2jGetMapping, j2a_get_mapping)) \
    J2A_IF_MANY(CALL(a2jMany, j2a_many)) \
    J2A_IF_PROPERTIES(MANY(a2jGetProperties, j2a_get_properties)) \
    J2A_IF_DEBUG(CALL(a2jDebug, j2a_get_debug)) \
    CALL(a2jEcho, j2a_echo) \
    J2A_IF_MANY(MANY(a2jEchoMany, j2a_echo_many)) \
    J2A_IF_INTERFACE(MANY(a2jGetInterface, j2a_get_interface)) \
    J2A_IF_TRANSDUCERS(MANY(a2jGetTransds, j2a_get_transds)) \
    J2A_IF_TRANSDUCERS(CALL(a2jTransd, j2a_transd)) \
    J2A_IF_CLOCK(CALL(a2jClock, j2a_clock))
/* End of what is generated. */

/* 1: the core is compiled without the list of transducers, as in the Arduino library. So it has no entries for them,
 * and those of an application that has a list are in its own table, before its functions (J2A-DISP-009). */
#ifndef J2A_TRANSDUCERS_APART
#define J2A_TRANSDUCERS_APART 0
#endif
#if J2A_TRANSDUCERS_APART
#undef J2A_IF_TRANSDUCERS
#define J2A_IF_TRANSDUCERS(text)
#if J2A_WITH_TRANSDUCERS
J2A_DECLARE_MANY(j2a_get_transds);
J2A_DECLARE_CALL(j2a_transd);
#endif
#endif

#define J2A_DECLARED_CALL(name, function) J2A_DECLARE_CALL(function);
#define J2A_DECLARED_MANY(name, function) J2A_DECLARE_MANY(function);
J2A_BUILTINS(J2A_DECLARED_CALL, J2A_DECLARED_MANY)

#define J2A_ONE(name, function) + 1
enum { J2A_BUILTIN_COUNT = !J2A_WITH_MAPPING J2A_BUILTINS(J2A_ONE, J2A_ONE) };

/* Bytes of their names in the map. */
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
    J2A_MAP_NAME(function, text)
#define J2A_MAP_NAME(function, text) static const char J2A_FLASH function##_map[] = text;
#define J2A_ENTRY(function, kind) {(j2a_function)(function), function##_map J2A_OF_KIND(kind)},
#define J2A_NO_ENTRY {0, 0 J2A_OF_KIND(J2A_KIND_CALL)}
#define J2A_RESERVED
#define J2A_TAKEN(name, function) enum { j2a_name_##name };
J2A_BUILTINS(J2A_TAKEN, J2A_TAKEN)
#else
#define J2A_NAME(function, text, enumerator)
#define J2A_MAP_NAME(function, text)
#define J2A_ENTRY(function, kind) {(j2a_function)(function) J2A_OF_KIND(kind)},
#define J2A_NO_ENTRY {0 J2A_OF_KIND(J2A_KIND_CALL)}
#define J2A_RESERVED J2A_NO_ENTRY,
#endif
#define J2A_NAMED(function, name) J2A_NAME(function, #name, j2a_name_##name)
#define J2A_CALL_ENTRY(name, function) J2A_ENTRY(function, J2A_KIND_CALL)
#define J2A_MANY_ENTRY(name, function) J2A_ENTRY(function, J2A_KIND_MANY)

/* The core's table. qualifier: J2A_WEAK, or nothing for one that replaces it. */
#define J2A_BUILTIN_NAME(name, function) J2A_MAP_NAME(function, #name)
#define J2A_BUILTIN_TABLE(qualifier) \
    J2A_BUILTINS(J2A_BUILTIN_NAME, J2A_BUILTIN_NAME) \
    const j2a_entry qualifier J2A_FLASH j2a_builtins[] = { \
        J2A_RESERVED J2A_BUILTINS(J2A_CALL_ENTRY, J2A_MANY_ENTRY) \
    };

/* What stands before and behind the entries of the application's table. It ends with one that is no function,
 * because C has no empty arrays. */
#define J2A_TABLE_BEGIN const j2a_entry J2A_FLASH j2a_functions[] = {
#define J2A_TABLE_END J2A_NO_ENTRY}; \
    enum { J2A_FUNCTION_COUNT = J2A_BUILTIN_COUNT + sizeof j2a_functions / sizeof j2a_functions[0] - 1 }; \
    extern char j2a_functions_are_more_than_255[J2A_FUNCTION_COUNT <= 255 ? 1 : -1]; \
    const uint8_t j2a_function_count = J2A_FUNCTION_COUNT;

/* Behind a table whose functions use no types of their own. */
#if J2A_WITH_INTERFACE
#define J2A_NO_DEFINITIONS \
    static const char J2A_FLASH j2a_no_definitions[] = ""; \
    const char *j2a_definitions(void) { \
        return j2a_no_definitions; \
    }
#else
#define J2A_NO_DEFINITIONS
#endif

#ifdef __cplusplus
}
#endif

#endif
