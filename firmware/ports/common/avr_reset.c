/* The cause of a reset, see avr_reset.h. In: MCUSR. Out: what the boot SIF tells. */
#include "avr_reset.h"

#include <avr/io.h>

#include "j2a_port.h"

#if J2A_WITH_BOOT
uint8_t avr_early_cause;

uint8_t avr_reset_cause(void) {
    const uint8_t flags = MCUSR;
    MCUSR = 0;
    if ((flags & _BV(PORF)) != 0) /* first: it may set the others, too */
        return J2A_BOOT_POWER;
    if ((flags & _BV(BORF)) != 0)
        return J2A_BOOT_BROWNOUT;
    if ((flags & _BV(WDRF)) != 0)
        return J2A_BOOT_WATCHDOG;
    return (flags & _BV(EXTRF)) != 0 ? J2A_BOOT_PIN : J2A_BOOT_UNKNOWN;
}

void avr_reset_begin(void) {
    avr_early_cause = avr_reset_cause();
}
#else
void avr_reset_begin(void) {
    MCUSR &= (uint8_t)~_BV(WDRF);
}
#endif
