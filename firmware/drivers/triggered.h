/* Which of these drivers the host triggers. In: transds.def. Out: IS_TRIGGERED(prefix), a constant: whether a line of a
 * sensor with this prefix has the key trigger. Such a driver measures when PREFIX_trigger() is called, and only then. */
#ifndef TRIGGERED_H
#define TRIGGERED_H

#include "j2a_options.h"

#define IS_TRIGGERED(prefix) ((TRIGGERED & TRIGGERED_BY_##prefix) != 0)

enum { TRIGGERED_BY_adc = 1, TRIGGERED_BY_quad = 2, TRIGGERED_BY_sharp = 4, TRIGGERED_BY_srf02 = 8 };

#if J2A_WITH_TRANSDUCERS
#include "transds.h"

/* Of each line the bit of its prefix if it has the key, else nothing. */
#define TRIGGER_OF_adc ~, | TRIGGERED_BY_adc
#define TRIGGER_OF_quad ~, | TRIGGERED_BY_quad
#define TRIGGER_OF_sharp ~, | TRIGGERED_BY_sharp
#define TRIGGER_OF_srf02 ~, | TRIGGERED_BY_srf02
#define J2A_ENUM(name, integer, ...)
#define J2A_STRUCT(name, ...)
#define J2A_TRANSD(KIND, name, id, prefix, model, channels, type, na, ...) \
    J2A_EACH(J2A_DRIVER_ITEM, J2A_DRIVER_ITEM, J2A_NOTHING, prefix, __VA_ARGS__)
#undef J2A_TRIGGER_DRIVER
#define J2A_TRIGGER_DRIVER(prefix) J2A_SECOND(TRIGGER_OF_##prefix, )
enum {
    TRIGGERED = 0
#include "j2a_transds_list.h"
};
#undef J2A_TRANSD
#undef J2A_STRUCT
#undef J2A_ENUM
#else
enum { TRIGGERED = 0 };
#endif

#endif
