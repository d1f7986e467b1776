/* What is wired to the pins of the simulated AVR: levels and voltages that come from outside, by
 * schedule, and the edges that are seen from outside. And the flags of their interrupts.
 *
 * In:  drive or release a pin, or set a voltage, at once or at a cycle to come.
 * Out: for each watched pin its edges with the cycle of each.
 * Rules: what is driven stays so across a reset of the chip; a pin that is not driven has the level
 * that the chip gives it (output, pull-up), or its last one. Of two things scheduled for one cycle
 * the one scheduled first comes first.
 * A pin that was released with a time for its rise stays low until its pull-up has been on for so
 * long: an open collector, and the capacitance of its wire.
 */
#ifndef J2A_SIM_BOARD_H
#define J2A_SIM_BOARD_H

#include <stdint.h>

#include "sim_avr.h"
#include "adc.h"
#include "avr_ioport.h"

enum { BOARD_PORTS = 12, BOARD_RELEASE = -1 };

typedef struct { uint64_t cycle; uint8_t level; } edge_t;

typedef struct {
    edge_t *edges; /* not yet taken */
    uint32_t count, size;
    uint8_t watched, level;
    struct board_port *port;
    uint32_t rise;     /* cycles that its pull-up takes */
    uint64_t rises_at; /* the cycle at which it will have; 0: the pull-up is off */
} board_pin_t;

typedef struct board_port {
    avr_ioport_t *io;
    uint8_t driven, levels;
    uint8_t charging; /* driven by nobody, and low until the pull-up has raised it */
    board_pin_t pins[8];
} board_port_t;

typedef struct {
    uint64_t cycle;
    int target;   /* port * 8 + bit, or BOARD_PORTS * 8 + channel of the ADC */
    double value; /* level, BOARD_RELEASE - cycles of its rise, or volts */
} board_event_t;

typedef struct {
    avr_t *avr;
    adc_t *adc;
    board_port_t ports[BOARD_PORTS];
    int port_count;
    board_event_t *events; /* by time, from `next` on still to come */
    uint32_t event_count, event_size, next;
} board_t;

void board_attach(board_t *, avr_t *, adc_t *);
/* After the chip was reset: what is driven is still there. */
void board_reset(board_t *);
void board_free(board_t *);
/* The number of a pin, port 'A'..'L' and bit 0..7; -1: the MCU has no such port. */
int board_pin(const board_t *, char port, int bit);
/* Level 0 or 1 or BOARD_RELEASE - cycles of its rise for a pin, volts for a channel of the ADC, when the cycle is reached. */
void board_schedule(board_t *, uint64_t cycle, int target, double value);
uint32_t board_waiting(const board_t *);
int board_level(const board_t *, int pin);
void board_watch(board_t *, int pin);
uint32_t board_edge_count(const board_t *, int pin);
/* Takes the edges of a pin away; the arrays hold board_edge_count() items. */
void board_take_edges(board_t *, int pin, uint64_t *cycles, uint8_t *levels);

#endif
