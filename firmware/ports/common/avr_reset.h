/* Why an AVR began anew: out of MCUSR flows the cause of the boot SIF.
 * Rule: it is asked once, because the flags are cleared; a boot loader that clears them itself leaves no cause. */
#ifndef AVR_RESET_H
#define AVR_RESET_H

#include <stdint.h>

/* Returns J2A_BOOT_UNKNOWN to J2A_BOOT_WATCHDOG. */
uint8_t avr_reset_cause(void);

#endif
