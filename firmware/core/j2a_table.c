/* Builds the function table and the properties of an application from its functions.def (see
 * j2a_functions.h) and its properties.def, lines of
 *   J2A_PROPERTY("key", "value") */
#include "j2a_functions.h"
#include "j2a_table.h"

/* J2A_IF_MANY: nobody could call a function of kind many without a2jMany, so it gets no opcode then. */

#if J2A_WITH_MAPPING
/* The map must fit into one frame: a negative array size stops the build when it does not. */
#define J2A_CALL(name, function) + sizeof #name
#define J2A_MANY(name, function) J2A_IF_MANY(+ sizeof #name)
typedef char j2a_names_longer_than_a_payload[
    J2A_BUILTIN_SIZE
#include "functions.def"
    <= J2A_ROOM ? 1 : -1];
#undef J2A_CALL
#undef J2A_MANY
#endif

#define J2A_CALL(name, function) J2A_NAME(function, #name, j2a_name_##name)
#define J2A_MANY(name, function) J2A_IF_MANY(J2A_NAME(function, #name, j2a_name_##name))
#include "functions.def"
#undef J2A_CALL
#undef J2A_MANY

J2A_TABLE_BEGIN
#define J2A_CALL(name, function) J2A_CALL_ENTRY(name, function)
#define J2A_MANY(name, function) J2A_IF_MANY(J2A_MANY_ENTRY(name, function))
#include "functions.def"
J2A_TABLE_END

#if J2A_WITH_PROPERTIES
/* An empty key would end the list. */
#define J2A_PROPERTY(key, value) \
    extern char j2a_property_is_empty[sizeof key > 1 && sizeof value > 1 ? 1 : -1];
#include "properties.def"
#undef J2A_PROPERTY
#define J2A_PROPERTY(key, value) key "\0" value "\0"
const unsigned char J2A_FLASH j2a_properties[] = J2A_PROPERTY_ROOM
#ifdef J2A_ADD_SPEC /* by the build, for a properties.def without it: it belongs to each device */
    J2A_PROPERTY("j2a.spec", J2A_SPEC_VERSION)
#endif
#include "properties.def"
    "";
#endif
