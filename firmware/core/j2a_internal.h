/* What the files of the core share. */
#ifndef J2A_INTERNAL_H
#define J2A_INTERNAL_H

#include <stddef.h>

#include "j2a_table.h"

/* What waits for j2a_process(): nothing, a frame, or the error code to be sent (0xF0 and up). */
enum { J2A_EVENT_NONE, J2A_EVENT_FRAME };

/* Of a2jGetProperties where it is built in: only a2jGetMapping and a2jMany stand before it (J2A-DISP-009). */
enum { J2A_PROPERTIES_OPCODE = 2 };

/* The state of one link, most of it the parser's. Bytes are refused while an event waits, so the frame
 * stays as it is. */
typedef struct {
    volatile uint8_t event;
    uint8_t state;       /* what the next byte is, and whether the last one was ESC */
    uint8_t checksum;    /* over the bytes so far */
    uint8_t count;       /* payload bytes so far */
    uint8_t seq;
    uint8_t opcode;      /* of the request */
    uint8_t length;      /* of the request's payload; of the error's where event is one */
    uint16_t last_ticks; /* when a byte was last taken */
#if J2A_WITH_SIF
    uint8_t sif_seq;     /* of the next SIF */
#endif
    uint8_t payload[J2A_ROOM]; /* last: what is near the start is reached by shorter code */
} j2a_rx_t;
extern j2a_rx_t j2a_rx_of[J2A_LINKS];

/* Returns the state of the link that is served. Functions keep it: on an AVR what is reached by a pointer
 * takes half the code of what has an address. */
static inline j2a_rx_t *j2a_served(void) {
    j2a_rx_t *served = &j2a_rx_of[j2a_link];
    J2A_KEEP_POINTER(served);
    return served;
}

/* Takes one byte; only while no event waits, or directly after j2a_rx_lost(). */
void j2a_rx_parse(uint8_t byte);

/* Ends a frame whose next byte did not come, if one is being received. */
void j2a_rx_timeout(void);

/* Sends one frame. start: J2A_SOF or J2A_SOS. */
void j2a_send(uint8_t start, uint8_t seq, uint8_t opcode, uint8_t length, const uint8_t *payload);

/* The end of the list of properties: puts the key and the value of j2a.selftest, of which the first
 * byte is number `at` of the list, behind the *length bytes of data; see j2a_get_properties(). */
void j2a_selftest_property(size_t at, uint32_t offset, bool *is_last, uint8_t *length, uint8_t *data);

/* Takes each byte that is sent: to the link, or to be compared while the self-test runs. */
#if J2A_WITH_SELFTEST
void j2a_tx_byte(uint8_t byte);
#else
#define j2a_tx_byte j2a_port_tx
#endif

/* Returns the entry in flash of an opcode below j2a_function_count. */
const j2a_entry *j2a_entry_of(uint8_t opcode);

/* Looks an opcode up. Returns 0 and the function when it is of this kind, else the site for the error
 * payload. */
uint8_t j2a_find(uint8_t opcode, uint8_t kind, j2a_function *function);

/* Makes an error reply: writes the site into the payload. Returns code. */
uint8_t j2a_error(uint8_t code, uint8_t site, uint8_t *length, uint8_t *payload);

#endif
