/* The TWI (I2C) of an AVR as a master. In: an address, bytes to write, and how many to read. Out: bytes, and
 * whether each was acknowledged.
 * Rules: one transfer at a time; its interrupts do it, about 90 us for a byte at 100 kHz, and nothing waits. A bus that hangs ends
 * no transfer, so the caller ends it with twi_stop() after a time of its own. On a chip
 * without a TWI each transfer fails at once, as if nobody were there. */
#ifndef TWI_H
#define TWI_H

#include <stdbool.h>
#include <stdint.h>

enum { TWI_BUSY, TWI_DONE, TWI_FAILED };

/* Switches the pull-ups and the TWI on, with 100 kHz. */
void twi_init(void);

/* Begins a transfer, if none is under way: writes, and after a repeated start reads. Each may be 0 bytes, not both.
 * address: 7 bits. bytes: stays until the end; what is read replaces what was written. */
void twi_transfer(uint8_t address, uint8_t *bytes, uint8_t writes, uint8_t reads);

/* What came of the transfer: TWI_BUSY, TWI_DONE or TWI_FAILED. */
uint8_t twi_state(void);

/* Gives a transfer up, which then has failed, and lets go of the wires. */
void twi_stop(void);

#endif
