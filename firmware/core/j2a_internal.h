/* What the files of the core share. */
#ifndef J2A_INTERNAL_H
#define J2A_INTERNAL_H

#include <stddef.h>

#include "j2a_clock.h"
#include "j2a_state.h"
#include "j2a_table.h"

/* What waits for j2a_process(): nothing, a frame, or the error code to be sent (0xF0 and up). */
enum { J2A_EVENT_NONE, J2A_EVENT_FRAME };

/* Of a2jGetProperties where it is built in: only a2jGetMapping and a2jMany stand before it (J2A-DISP-009). */
enum { J2A_PROPERTIES_OPCODE = 2 };

/* Returns the state of the link that is served. Functions keep it: on an AVR what is reached by a pointer
 * takes half the code of what has an address. */
static inline j2a_rx_t *j2a_served(void) {
    j2a_rx_t *served = &j2a_rx_of[j2a_link];
    J2A_KEEP_POINTER(served);
    return served;
}

/* Takes one byte; only while no event waits, or directly after j2a_rx_lost(). */
void j2a_rx_parse(uint8_t byte);

/* Returns the room for payloads of the link that is served, null while a request or an error is in it. What lies there is
 * gone with the next byte that is parsed. */
#if J2A_PORT_SHARES_ROOM
uint8_t *j2a_rx_room(void);
#endif

/* Ends a frame whose next byte did not come, if one is being received. */
void j2a_rx_timeout(void);

/* Sends the boot SIF on the link that is served, unless it was sent or the link is down. Returns whether it was
 * sent. */
#if J2A_WITH_BOOT
bool j2a_greet(void);

/* Returns the CRC-32 of the interface. */
uint32_t j2a_interface_hash(void);
#endif

/* Set with each request that is executed, for the watchdogs of actuators. */
#if J2A_WITH_TRANSDUCERS
extern bool j2a_is_heard;
#endif

/* Sends one frame. start: J2A_SOF or J2A_SOS. */
void j2a_send(uint8_t start, uint8_t seq, uint8_t opcode, uint8_t length, const uint8_t *payload);

#if J2A_WITH_SELFTEST || J2A_WITH_INTERFACE
/* Puts one more property, with key and value, behind the *length bytes of data, as far as it is in the chunk that
 * begins at `offset` of the list. at: where in the list the property begins. *is_last: false if it goes on. */
J2A_INLINE void j2a_append(const char *property, uint8_t size, size_t at, uint32_t offset, bool *is_last,
                           uint8_t *length, uint8_t *data) {
    uint8_t i;
    for (i = 0; i < size; i++, at++) {
        if (at < offset)
            continue;
        if (*length == J2A_ROOM_MANY) {
            *is_last = false;
            break;
        }
        data[(*length)++] = (uint8_t)property[i];
    }
}
#endif

/* The property j2a.interface, see j2a_append(), and its bytes. */
#if J2A_WITH_INTERFACE
enum { J2A_INTERFACE_BYTES = sizeof "j2a.interface" + sizeof "01234567" };
#else
enum { J2A_INTERFACE_BYTES = 0 };
#endif
void j2a_interface_property(size_t at, uint32_t offset, bool *is_last, uint8_t *length, uint8_t *data);

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
