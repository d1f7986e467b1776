/* The EEPROM of an AVR as the memory that stays without power, see j2a_port_kept() in core/j2a_port.h.
 * In: bytes that the core keeps. Out: the same after each reset.
 * Rules: it begins at J2A_EEPROM_AT, so that an application can have the bytes before it. A write takes 3.4 ms, during
 * which a read waits and nothing else does; no interrupt may use the EEPROM. */
#ifndef AVR_EEPROM_H
#define AVR_EEPROM_H

#include <avr/io.h>

#ifndef J2A_EEPROM_AT
#define J2A_EEPROM_AT 0
#endif
#define J2A_PORT_KEPT_BYTES (E2END + 1 - J2A_EEPROM_AT)

#endif
