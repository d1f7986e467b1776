/* Why an AVR began anew: out of MCUSR flows the cause of the boot SIF.
 * Rule: it is asked once, because the flags are cleared; a boot loader that clears them itself leaves no cause. */
#ifndef AVR_RESET_H
#define AVR_RESET_H

#include <stdint.h>

/* Returns J2A_BOOT_UNKNOWN to J2A_BOOT_WATCHDOG. */
uint8_t avr_reset_cause(void);

/* For ports that must clear WDRF long before a host comes: keeps the cause for the boot SIF, else all other causes for the
 * application. */
void avr_reset_begin(void);
extern uint8_t avr_early_cause;

#endif
