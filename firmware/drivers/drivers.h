/* The drivers that transds.def names. In: the prefixes of its lines. Out: calls of PREFIX_init() and PREFIX_task(), once
 * for each prefix, in the order of the lines. Each driver has both, so that another one in a line needs no other
 * change. */
#ifndef DRIVERS_H
#define DRIVERS_H

#include "transds.h"

#define J2A_ENUM(name, integer, ...)
#define J2A_STRUCT(name, ...)
#define J2A_TRANSD(KIND, name, id, prefix, ...) \
    void prefix##_init(void); \
    void prefix##_task(void);
#include "j2a_transds_list.h"
#undef J2A_TRANSD
#undef J2A_STRUCT
#undef J2A_ENUM

/* Called once, behind transds_init(), so that no value comes before its callback. */
void drivers_init(void);

/* Called in each turn of the main loop. */
void drivers_task(void);

#endif
