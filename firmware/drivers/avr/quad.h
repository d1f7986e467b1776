/* Two quadrature encoders on pins that interrupt. In: their signals. Out: a count for each, and of the transitions that
 * were illegal, with a call for each new count.
 * Rules: the count wraps at 16 bits. The callbacks run in the interrupt, or with interrupts off, and must be short. Edges
 * that come faster than the interrupt takes are lost; where both channels have changed in between, that is an illegal
 * transition, and the count stays as it was. With the key trigger no step calls back, but quad_trigger(). */
#ifndef QUAD_H
#define QUAD_H

#include <stdint.h>

enum { QUAD_COUNT = 2 };

/* Until an open collector that lets go is high: pull-ups have up to 50 kOhm, so a wire of 1 nF (about 10 m) has
 * reached 63 %, and the input needs 60 %. */
#define QUAD_RISE_US 50

/* Switches pull-ups and interrupts on, and takes QUAD_RISE_US: encoders with open collectors need nothing else.
 * Where they stand then is count 0. Later calls do nothing. */
void quad_init(void);

/* Nothing: the interrupt does all. */
void quad_task(void);
void quad_misses_init(void);
void quad_misses_task(void);

/* The callback for new counts, NULL for none (thesis, listing 9.1). */
void quad_set_cb(void (*new_value)(uint8_t channel, int16_t value));

/* The callback for the illegal transitions since the start, NULL for none. They stay at 65535. */
void quad_misses_set_cb(void (*new_value)(uint8_t channel, uint16_t value));

/* Calls back for both counts, which are of one moment. Called from the main context. */
void quad_trigger(void);

int16_t quad_get(uint8_t channel);

/* Sets the count, which is then a new one like that of a step. */
void quad_set(uint8_t channel, int16_t value);

#endif
