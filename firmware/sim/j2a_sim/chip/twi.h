/* The devices on the two wires of the TWI (I2C): ultrasonic sensors SRF02, by address, and a bus that hangs.
 *
 * In:  distances, what a sensor does, bytes of the firmware. Out: bytes for it.
 * Rules: simavr's own model of the TWI stays, and gets its acknowledges and bytes from here. A sensor that measures
 * does not answer. A bus that hangs, as with a wire held low, ends no step that the firmware begins.
 */
#ifndef J2A_SIM_TWI_H
#define J2A_SIM_TWI_H

#include "sim_avr.h"
#include "avr_twi.h"

enum { TWI_ADDRESSES = 128 };
/* What a sensor does; TWI_DEAF acknowledges its address and nothing that is written to it. */
enum { TWI_ABSENT, TWI_SRF02, TWI_DEAF };

typedef struct {
    uint8_t kind;
    uint16_t cm;         /* the distance now */
    uint16_t measured;   /* what the registers hold */
    uint8_t reg;         /* that is read or written next */
    uint8_t has_reg;     /* since the address was written */
    uint64_t ready_at;   /* the cycle at which it answers again */
    uint8_t is_measuring;
    uint32_t measurements;
} srf02_t;

typedef struct {
    avr_t *avr;
    avr_twi_t *port; /* NULL: the chip has none */
    avr_io_write_t write;
    void *param;
    uint8_t stuck;
    uint8_t is_address; /* the byte of this step is one */
    uint8_t is_done;    /* the step has ended at once */
    srf02_t sensors[TWI_ADDRESSES];
} twi_t;

void twi_attach(twi_t *, avr_t *);

#endif
