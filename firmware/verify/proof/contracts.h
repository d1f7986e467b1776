/* What the functions of the core promise, in ACSL. Eva proves each clause for the states in which
 * parser.c and program.c call them. The proof of the program takes what the parser promises as given,
 * and the proof of the parser shows it (see docs/conformance/proof.md). */
#ifndef CONTRACTS_H
#define CONTRACTS_H

#include "j2a_internal.h"
#include "numbers.h"

/* The state of the link that is served. */
#define j2a_rx (j2a_rx_of[j2a_link])

/* The states of j2a_rx.c, which keeps their names to itself. */
enum { P_IDLE, P_SEQ, P_OPCODE, P_LENGTH, P_PAYLOAD, P_CHECKSUM, P_ESCAPED = 0x80 };
#define DUE(state) ((uint8_t)((state) & ~P_ESCAPED)) /* what the next byte is */

/*@ predicate sound_event(integer event) =
      event == J2A_EVENT_NONE || event == J2A_EVENT_FRAME || event == J2A_ERR_TIMEOUT
      || event == J2A_ERR_CHECKSUM || event == J2A_ERR_FRAMING;

    predicate is_due(integer what) = j2a_rx.state == what || j2a_rx.state == what + P_ESCAPED;

    // What holds between any two calls. The third line keeps the payload inside its 255 bytes, the last
    // one what is sent of it.
    predicate sound_parser =
      (j2a_rx.state <= P_CHECKSUM || P_SEQ + P_ESCAPED <= j2a_rx.state <= P_CHECKSUM + P_ESCAPED)
      && (is_due(P_SEQ) || is_due(P_OPCODE) || is_due(P_LENGTH) ==> j2a_rx.count == 0)
      && (is_due(P_PAYLOAD) ==> j2a_rx.count < j2a_rx.length)
      && (j2a_rx.event != J2A_EVENT_NONE ==> j2a_rx.state <= P_SEQ)
      && sound_event(j2a_rx.event)
      && (j2a_rx.event > J2A_EVENT_FRAME ==> j2a_rx.length == 2); */

/*@ requires sound_event(j2a_rx.event);
    ensures sound_event(j2a_rx.event); */
void j2a_rx_parse(uint8_t byte);

/*@ requires sound_event(j2a_rx.event);
    ensures sound_event(j2a_rx.event);
    ensures \result == 0 || \result == 1;
    ensures \result == 0 ==> j2a_rx.event != J2A_EVENT_NONE; */
bool j2a_rx_byte(uint8_t byte);

/*@ requires sound_event(j2a_rx.event);
    ensures sound_event(j2a_rx.event); */
void j2a_rx_lost(void);

/*@ requires j2a_rx.event == J2A_EVENT_NONE;
    ensures j2a_rx.event == J2A_EVENT_NONE || j2a_rx.event == J2A_ERR_TIMEOUT; */
void j2a_rx_timeout(void);

/*@ requires start == J2A_SOF || start == J2A_SOS;
    requires length > 0 ==> \valid_read(payload + (0 .. length - 1)); */
void j2a_send(uint8_t start, uint8_t seq, uint8_t opcode, uint8_t length, const uint8_t *payload);

#if J2A_WITH_SIF
/*@ requires length > 0 ==> \valid_read(payload + (0 .. length - 1)); */
void j2a_send_sif(uint8_t opcode, uint8_t length, const uint8_t *payload);
#endif

/*@ requires \valid(function);
    ensures \result == 0 || \result == J2A_SITE_OPCODE || \result == J2A_SITE_KIND;
    ensures \result == 0 ==> \initialized(function); */
uint8_t j2a_find(uint8_t opcode, uint8_t kind, j2a_function *function);

/*@ requires \valid(length) && \valid(payload + (0 .. 1));
    ensures \result == code && *length == 2 && \initialized(payload + (0 .. 1)); */
uint8_t j2a_error(uint8_t code, uint8_t site, uint8_t *length, uint8_t *payload);

#if J2A_WITH_MANY
/*@ requires \valid(length) && \valid(payload) && \valid(*payload + (0 .. J2A_ROOM - 1));
    requires *length <= J2A_ROOM;
    ensures \result <= J2A_RET_MAX || \result == J2A_RET_FAILED || \result == J2A_ERR_OPCODE; */
uint8_t j2a_many(uint8_t *const length, uint8_t **const payload);
#endif

#endif
