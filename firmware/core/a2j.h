/* The programming interface of the thesis (listings 7.1, 7.2 and 7.4) and of the firmware of 2014 on
 * top of this core. In: one C file of the user with functions, jump table, properties and a main
 * loop in the old names. Out: the tables that the core expects. Such an app has no functions.def,
 * and its app.mk says OWN_MAIN := 1, and APP_OPTIONS := -std=gnu11 when it repeats the types. Rules: a
 * function's kind is taken from its type (needs GCC or Clang); a map that is longer than J2A_ROOM by names of
 * the user is only refused at run time, by a2jGetMapping. */
#ifndef A2J_H
#define A2J_H

#include "j2a_table.h"

#if !J2A_WITH_MANY
#error "a2j.h needs J2A_WITH_MANY=1: its tables hold functions of both kinds"
#endif

/* A negative array size where not even the names of the built-in functions fit into the map. The first chunk of
 * properties, below, is always shorter. */
#if J2A_WITH_MAPPING
typedef char j2a_names_longer_than_a_payload[J2A_BUILTIN_SIZE <= J2A_ROOM ? 1 : -1];
#endif

/* The listing's types; C11 allows them to be declared again. */
typedef j2a_call_fn *const CMD_P;
typedef j2a_many_fn *const CMD_P_MANY;

/* Jump table: FUNCMAP(function, name on the wire) for each function, then the table. */
#define FUNCMAP J2A_NAMED
#define STARTJT J2A_BUILTIN_TABLE() J2A_TABLE_BEGIN
#define STARTJ STARTJT /* as printed in listing 7.2 */
#define ADDLJT ADDJT /* as printed in listing 7.3 */
#define ADDJT(function) J2A_ENTRY(function, A2J_KIND(function))
#define ENDJT J2A_TABLE_END J2A_NO_DEFINITIONS

#define A2J_IS(function, type) __builtin_types_compatible_p(__typeof__(&(function)), type)
/* The array has a negative size when the function is neither a CMD_P nor a CMD_P_MANY. */
#define A2J_KIND(function) (A2J_IS(function, CMD_P_MANY) ? J2A_KIND_MANY : J2A_KIND_CALL \
    + 0 * (int)sizeof(char[A2J_IS(function, CMD_P) || A2J_IS(function, CMD_P_MANY) ? 1 : -1]))

/* Properties, by the listing's own definitions, so that it may come with them: one or more, at most 255
 * bytes. No ADDPROP(j2a.spec, ...): a2j_get_properties() adds that one, and keys must not repeat. */
#ifndef PROGMEM
#define PROGMEM J2A_FLASH
#endif
#define STARTPROPS unsigned char const PROGMEM a2j_props[] = {
#define ADDPROP(key, value) #key "\0" #value "\0"
#define STRFY(x) #x
#define ADDPROPEXP(key, value) #key "\0" STRFY(value) "\0"
#define ENDPROPS }; const uint8_t a2j_props_size = sizeof(a2j_props) - 1;

#if J2A_WITH_PROPERTIES
extern unsigned char const a2j_props[] __asm__("j2a_properties"); /* the name that the core looks for */

/* a2jGetProperties of such a device: j2a.room, j2a.caps and j2a.spec as the first chunk, then the user's. */
static inline uint8_t a2j_get_properties(bool *is_last, bool is_write, uint32_t *const offset,
                                         uint8_t *const length, uint8_t **const data) {
    static uint8_t spec[] = J2A_PROPERTY_ROOM J2A_PROPERTY_CAPS "j2a.spec\0" J2A_SPEC_VERSION;
    uint8_t code;
    if (!is_write && *offset < sizeof spec) {
        *is_last = false;
        *length = (uint8_t)(sizeof spec - *offset);
        *data = spec + *offset;
        return 0;
    }
    *offset -= sizeof spec;
    code = j2a_get_properties(is_last, is_write, offset, length, data);
    *offset += sizeof spec;
    return code;
}
#define j2a_get_properties a2j_get_properties /* in STARTJT's table of built-ins, which replaces the core's */
#endif

static inline void a2jInit(void) {
    j2a_selftest();
    j2a_port_init(0, 0);
}

/* The main loop: for (;;) { a2jTask(); a2jProcess(); } */
static inline void a2jTask(void) {
    j2a_poll();
}

static inline void a2jProcess(void) {
    j2a_process();
    j2a_port_idle();
}

#if J2A_WITH_SIF
/* See j2a_send_sif(). Returns 0. */
static inline uint8_t a2jSendSif(uint8_t cmd, uint8_t len, const uint8_t *data) {
    j2a_send_sif(cmd, len, data);
    return 0;
}
#endif

#endif
