/* What is kept of each link, in RAM. Here, and not with what only the core's files share, because the functions
 * that j2a_table.c makes of functions.def use one byte of it; see j2a_typed.h. */
#ifndef J2A_STATE_H
#define J2A_STATE_H

#include "j2a.h"

#ifdef __cplusplus
extern "C" {
#endif

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
#if J2A_WITH_BOOT
    bool has_greeted;    /* the boot SIF was sent */
#endif
    uint8_t payload[J2A_ROOM]; /* last: what is near the start is reached by shorter code */
} j2a_rx_t;
extern j2a_rx_t j2a_rx_of[J2A_LINKS];

#ifdef __cplusplus
}
#endif

#endif
