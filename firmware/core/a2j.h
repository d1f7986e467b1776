/* The programming interface of the thesis (listings 7.1, 7.2 and 7.4) and of the firmware of 2014 on
 * top of this core. In: one C file of the user with functions, jump table, properties and a main
 * loop in the old names. Out: the tables that the core expects. Such an app has no functions.def,
 * and its app.mk says OWN_MAIN := 1. Rules: a function's kind is taken from its type (needs GCC or
 * Clang); a map longer than 255 bytes is only refused at run time, by a2jGetMapping. */
#ifndef A2J_H
#define A2J_H

#include "j2a_table.h"

typedef j2a_call_fn *const CMD_P;
typedef j2a_many_fn *const CMD_P_MANY;

/* Jump table: FUNCMAP(function, name on the wire) for each function, then the table. */
#define FUNCMAP(function, alias) J2A_NAME(function, #alias)
#define STARTJT J2A_BUILTIN_NAMES const j2a_entry J2A_FLASH j2a_functions[] = {J2A_BUILTIN_ENTRIES
#define STARTJ STARTJT /* as printed in listing 7.2 */
#define ADDJT(function) , J2A_ENTRY(function, A2J_KIND(function))
#define ENDJT }; const uint8_t J2A_FLASH j2a_function_count = sizeof j2a_functions / sizeof(j2a_entry);

#define A2J_IS(function, type) __builtin_types_compatible_p(__typeof__(&(function)), type)
/* The array has a negative size when the function is neither a CMD_P nor a CMD_P_MANY. */
#define A2J_KIND(function) (A2J_IS(function, CMD_P_MANY) ? J2A_KIND_MANY : J2A_KIND_CALL \
    + 0 * (int)sizeof(char[A2J_IS(function, CMD_P) || A2J_IS(function, CMD_P_MANY) ? 1 : -1]))

/* Properties; the one that every device of this version has comes with them. */
#define STARTPROPS const unsigned char J2A_FLASH j2a_properties[] = {"j2a.spec\0" J2A_SPEC_VERSION "\0"
#define ADDPROP(key, value) #key "\0" #value "\0"
#define STRFY(x) #x
#define ADDPROPEXP(key, value) #key "\0" STRFY(value) "\0"
#define ENDPROPS };

static inline void a2jInit(void) {
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
/* Returns 0 when the frame was sent, else see j2a_send_sif(). */
static inline uint8_t a2jSendSif(uint8_t cmd, uint8_t len, const uint8_t *data) {
    return j2a_send_sif(cmd, len, data) ? 0 : J2A_RET_FAILED;
}
#endif

#endif
