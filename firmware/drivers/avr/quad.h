/* Two quadrature encoders on pins that interrupt. In: their signals. Out: a count for each, and a call for
 * each new count.
 * Rules: the count wraps at 16 bits. The callback runs in the interrupt and must be short. Edges that come
 * faster than the interrupt takes are lost; where both channels have changed in between, it is seen and
 * counted as an error, and the count stays as it was. */
#ifndef QUAD_H
#define QUAD_H

#include <stdint.h>

enum { QUAD_COUNT = 2 };

/* Until an open collector that lets go is high: pull-ups have up to 50 kOhm, so a wire of 1 nF (about 10 m) has
 * reached 63 %, and the input needs 60 %. */
#define QUAD_RISE_US 50

/* Switches pull-ups and interrupts on, and takes QUAD_RISE_US: encoders with open collectors need nothing else.
 * Where they stand then is count 0. */
void quad_init(void);

/* The callback for new counts. Called by the interrupt.
 * Either a function that is set, NULL for none, as in the thesis (listing 9.1); or, with
 * -DQUAD_CALLBACK=function, that function, which link-time optimisation makes part of the interrupt: 140 cycles
 * instead of 189 for a step, 195 instead of 281 when both encoders step at once. */
#ifdef QUAD_CALLBACK
void QUAD_CALLBACK(uint8_t channel, int16_t value);
#else
void quad_set_cb(void (*new_value)(uint8_t channel, int16_t value));
#endif

int16_t quad_get(uint8_t channel);

void quad_set(uint8_t channel, int16_t value);

/* Illegal transitions since the start; stays at 65535. */
uint16_t quad_errors(uint8_t channel);

#endif
