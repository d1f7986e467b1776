/* One direction of a serial wire: levels over time, and the receiver at its end.
 *
 * In:  characters of a sender with its bit time (wire_send), the receiver's bit time.
 * Out: the characters that the receiver makes of the levels that it samples by its own clock.
 * Times are in cycles of the simulated AVR and need not be whole. With equal clocks every character
 * arrives as it was sent; with unequal ones bits are sampled wrongly, stop bits are missed, and a
 * later edge is taken for a start bit, as on a real wire. A receiver that is switched on amid a character
 * takes its next falling edge for a start bit. A start bit shorter than half a bit of the receiver is given
 * up only when the character would have ended.
 */
#ifndef J2A_SIM_WIRE_H
#define J2A_SIM_WIRE_H

#include <stdint.h>

#include "sim_avr.h"

enum { WIRE_RECENT = 4 };

typedef struct {
    unsigned data, parity, stop; /* bits; parity: 0 none, 2 even, 3 odd */
} wire_format_t;

/* A character: bit 0 of `levels` is the start bit. */
typedef struct {
    double start, bit;
    unsigned levels, bits;
} wire_char_t;

typedef struct {
    avr_t *avr; /* whose cycles are the time */
    void *user; /* first argument of the functions */
    wire_format_t (*format)(void *user);        /* of both ends */
    double (*receiver_bit)(void *user);
    void (*edge)(void *user);                   /* a start bit is seen; may be NULL */
    void (*deliver)(void *user, uint8_t byte, int framing_error, int parity_error);
    int listens;                                /* the receiver is on */
    wire_char_t recent[WIRE_RECENT];            /* newest first */
    enum { WIRE_IDLE, WIRE_EDGE_AHEAD, WIRE_SAMPLING } state;
    double start, bit;                          /* of the character that is being received */
} wire_t;

unsigned wire_char_bits(wire_format_t);
/* Puts a character on the wire; returns the time at which its last stop bit ends. */
double wire_send(wire_t *, double start, double bit, uint8_t byte);
/* The sender was reset, and simavr has dropped all timers: the wire is high from the end of this bit on. The
 * receiver has the character at once, as the time in which a chip starts is not simulated. */
void wire_cut(wire_t *);
/* Switches the receiver; one that is off forgets what it is receiving. */
void wire_listen(wire_t *, int on);

#endif
