/* How often the firmware's interrupts come, how long they take and how late they are.
 *
 * In:  simavr's word that a vector is pending, entered, left. Out: counts and cycles for each vector.
 * Rules: a handler's time goes from the first of the 4 cycles in which the chip enters it to the end of
 * RETI, with whatever interrupts it meanwhile. How late it is counts from its flag to that first cycle.
 */
#ifndef J2A_SIM_INTERRUPTS_H
#define J2A_SIM_INTERRUPTS_H

#include "sim_avr.h"

enum { VECTORS = 64 };

typedef struct {
    avr_t *avr;
    uint64_t pending, entered; /* cycles */
    uint64_t count, longest, total, latest;
} interrupt_t;

typedef struct { interrupt_t of[VECTORS]; } interrupts_t;

void interrupts_attach(interrupts_t *, avr_t *);
void interrupts_clear(interrupts_t *);

#endif
