/* See drivers.h. The headers are here so that a line whose type is not that of its driver does not compile. */
#include "drivers.h"

#include "adc.h"
#include "quad.h"
#include "servo.h"
#include "sharp_sensor.h"
#include "srf02.h"

#define J2A_ENUM(name, integer, ...)
#define J2A_STRUCT(name, ...)

/* A prefix may stand in several lines, and the compiler drops all calls but the first: each line opens a block that says
 * of its prefix first that it was not called, and behind the call that it was. */
J2A_ALWAYS_INLINE void call_each(bool is_start) {
#define J2A_TRANSD(KIND, name, id, prefix, ...) \
    { \
        enum { is_called_##prefix = 0 };
#include "j2a_transds_list.h"
#undef J2A_TRANSD
#define J2A_TRANSD(KIND, name, id, prefix, ...) \
    if (!is_called_##prefix) { \
        if (is_start) \
            prefix##_init(); \
        else \
            prefix##_task(); \
    } \
    { \
        enum { is_called_##prefix = 1 };
#include "j2a_transds_list.h"
#undef J2A_TRANSD
#define J2A_TRANSD(KIND, name, id, prefix, ...) }}
#include "j2a_transds_list.h"
#undef J2A_TRANSD
}

void drivers_init(void) {
    call_each(true);
}

void drivers_task(void) {
    call_each(false);
}
