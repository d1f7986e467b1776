/* The EEPROM's control register in time: simavr writes a byte at once and is ready again, the chip takes 3.4 ms.
 *
 * In:  what the firmware writes to EECR. Out: EEPE set until a write is over, the bytes, the interrupt.
 * Rules: a byte is there when its write begins; one that begins while another lasts is ignored, as is one without
 * EEMPE in the four cycles before. A write goes on through a reset, which leaves EEPE set until it is over. The CPU
 * stands still for four cycles at a read, and for two at a write. The interrupt is a level: no write lasts.
 * Erasing and writing apart (EEPM) are not modelled: each write does both.
 */
#ifndef J2A_SIM_EEPROM_H
#define J2A_SIM_EEPROM_H

#include <stdint.h>

#include "sim_avr.h"
#include "avr_eeprom.h"

typedef struct {
    avr_eeprom_t *port;   /* NULL: the chip has none */
    uint64_t busy_until;  /* the cycle at which the last write is over */
} eeprom_t;

/* After memory_widen(). Returns -1 without memory. */
int eeprom_attach(eeprom_t *, avr_t *);

#endif
