/* Two servos. In: deflections. Out: a pulse each 20 ms on the pins OC1A and OC1B.
 * Timer 1 runs freely, as the port has set it; its compare units switch the pins at their tick, so no
 * interrupt, however late, moves an edge. The interrupt after an edge has a millisecond to prepare the next.
 * Rules: widths are whole ticks (4 us at 16 MHz). A new width counts from the next pulse on. The second
 * servo's pulses come half a period after the first one's, so that their interrupts do not meet. */
#ifndef SERVO_H
#define SERVO_H

#include <stdint.h>

enum { SERVO_COUNT = 2 };

/* Call it after j2a_port_init(). No pulses come until a deflection is set. */
void servo_init(void);

/* Nothing: the interrupts do all. */
void servo_task(void);

/* Deflection -100..100, see ticks.h; what is beyond counts as full. */
void servo_set(uint8_t channel, int8_t deflection);

#endif
