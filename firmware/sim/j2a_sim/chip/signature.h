/* The signature row of the AVRs with USB: what the chip is, and its serial number.
 *
 * In:  SIGRD and SPMEN written to SPMCSR, and LPM soon after. Out: what that LPM reads.
 * simavr has no such row. Between the two, instructions are run one by one, and the byte of the row is put
 * into the flash for that LPM alone, so that no interrupt can run into it.
 *
 * Rules: as in 27.9.4 of the ATmega16U4/32U4 data sheet (J): the LPM begins within three cycles, or reads the
 * flash. The serial number is where chips have it, though the data sheets do not tell. What else is in the row
 * is not modelled and reads 0xff. A chip takes nothing into SPMCSR while it writes EEPROM, so it reads no
 * row then.
 */
#ifndef J2A_SIM_SIGNATURE_H
#define J2A_SIM_SIGNATURE_H

#include <stdint.h>

#include "sim_avr.h"

enum { SIGNATURE_SERIAL = 10 };

typedef struct {
    avr_t *avr;
    avr_io_write_t write; /* simavr's own hook of SPMCSR, for what is not the signature row */
    void *param;
    enum { ROW_CLOSED, ROW_ASKED, ROW_OPEN } state;
    avr_cycle_count_t until;
    uint8_t serial[SIGNATURE_SERIAL];
} signature_t;

/* Only for chips whose SPMCSR is that of the AVRs with USB. */
void signature_attach(signature_t *, avr_t *, const uint8_t *serial);
/* Use this in place of avr_run_one(). */
avr_flashaddr_t signature_run(signature_t *);

#endif
