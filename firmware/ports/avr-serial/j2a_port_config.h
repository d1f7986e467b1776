#include "avr_clock.h"
#include "avr_eeprom.h"
#include "avr_reset.h"

#define J2A_TICKS_PER_MS AVR_CLOCK_TICKS_PER_MS
#define J2A_PORT_NAME "avr-serial"
#define J2A_PORT_BOOT_CAUSE avr_reset_cause()
