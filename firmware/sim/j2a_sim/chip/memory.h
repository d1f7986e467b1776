/* The memories of the simulated chip: no address that firmware can form leads out of them.
 *
 * In:  a chip that avr_init() has set up. Out: the same chip with memories that are large enough.
 * simavr allocates what the chip has and trusts the firmware: a store beyond the RAM stops the chip, and
 * is done all the same, into the heap of this process; LPM, ELPM, SPM, the EEPROM and the log of a UART are not
 * checked at all.
 *
 * Rules: the data space is 64 KiB; a store, load, push or pop beyond the RAM stops the chip. A read of
 * program memory and an EEPROM address ignore the bits that the chip does not have. SPM beyond the flash
 * changes nothing that runs.
 */
#ifndef J2A_SIM_MEMORY_H
#define J2A_SIM_MEMORY_H

#include "sim_avr.h"

/* After avr_init() and before anything keeps a pointer into the memories. Returns -1 without memory. */
int memory_widen(avr_t *);
/* After avr_loadcode(). */
void memory_mirror(avr_t *);

#endif
