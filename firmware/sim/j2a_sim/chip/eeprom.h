/* The EEPROM's control register in time: simavr writes a byte at once and is ready again, the chip takes 3.4 ms.
 *
 * In:  what the firmware writes to EECR. Out: EEPE set until a write is over, the bytes, the interrupt.
 * Rules: a byte is there when its write begins; one that begins while another lasts is ignored, as is one without
 * EEMPE in the four cycles before. A reset ends a write, and leaves the byte.
 */
#ifndef J2A_SIM_EEPROM_H
#define J2A_SIM_EEPROM_H

#include "sim_avr.h"
#include "avr_eeprom.h"

/* After memory_widen(). */
void eeprom_attach(avr_t *);
/* The bytes; NULL on a chip without them. */
uint8_t *eeprom_bytes(const avr_t *);

#endif
