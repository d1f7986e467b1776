/* Why an AVR began anew: out of MCUSR flows the cause of the boot SIF.
 * Rule: it is asked once, because the flags are cleared; a boot loader that clears them itself leaves no cause. */
#ifndef AVR_RESET_H
#define AVR_RESET_H

#include <avr/io.h>
#include <stdint.h>

#include "j2a_const.h"

static inline uint8_t avr_reset_cause(void) {
    const uint8_t flags = MCUSR;
    MCUSR = 0;
    if (flags & _BV(PORF)) /* first: the others may be set by it, too */
        return J2A_BOOT_POWER;
    if (flags & _BV(BORF))
        return J2A_BOOT_BROWNOUT;
    if (flags & _BV(WDRF))
        return J2A_BOOT_WATCHDOG;
    return flags & _BV(EXTRF) ? J2A_BOOT_PIN : J2A_BOOT_UNKNOWN;
}

#endif
