/* What an application uses. Requests of the host come in through j2a_task(), which calls the
 * application's functions (listed in its functions.def, declared by j2a_functions.h) and sends what
 * they leave behind.
 * Rules: all of it is called from the main context only (the main loop and functions), never from an
 * interrupt; functions run to their end, and do not call j2a_task() themselves. */
#ifndef J2A_H
#define J2A_H

#include <stdbool.h>
#include <stdint.h>

#include "j2a_numbers.h"
#include "j2a_options.h"
#include "j2a_port.h"
#include "j2a_progmem.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The declarations of functions are macros, because SDCC declares no function by a typedef. */

/* A function of kind "call", J2A_CALL(name, function) in functions.def.
 * length: in the bytes of the request's payload, out those of the reply's, 0..255.
 * payload: where they are. The reply may be written over the request (J2A_ROOM bytes), or *payload may be
 * pointed at up to 255 bytes elsewhere that stay valid after the return.
 * Returns the return value, 0x00..J2A_RET_MAX, or J2A_RET_FAILED; anything else is sent as
 * J2A_RET_FAILED. */
#define J2A_DECLARE_CALL(function) uint8_t function(uint8_t *const length, uint8_t **const payload)
typedef J2A_DECLARE_CALL(j2a_call_fn);

/* A function of kind "many", J2A_MANY(name, function) in functions.def, called once for each chunk.
 * is_last: in the host's mark of the last chunk, out the same for the reply.
 * is_write: the host writes *length bytes at *offset; else it reads from *offset, any number up to
 * J2A_ROOM_MANY, which is 249 unless the room is less.
 * offset: bytes from the start of the data; what is left here goes back to the host.
 * length, data: as for a call, with at most J2A_ROOM_MANY bytes; *data may be pointed at memory
 * outside the request.
 * Returns as a call does. */
#define J2A_DECLARE_MANY(function) uint8_t function(bool *is_last, bool is_write, uint32_t *const offset, \
                                                    uint8_t *const length, uint8_t **const data)
typedef J2A_DECLARE_MANY(j2a_many_fn);

/* Receives and answers: j2a_poll(), then j2a_process(). Called in each turn of the main loop, at
 * least every 5 ms while frames arrive: a byte timeout comes late by the time between two calls, which
 * includes what functions and sending take (a SIF of 255 bytes up to 45 ms at 115200 baud).
 * With J2A_LINKS of more than 1 each link has its turn, and j2a_link is in the end what it was before.
 * Within a function j2a_link is the link that the request came from. */
void j2a_task(void);

/* The first half of j2a_task(): takes received bytes from the port, and watches the byte timeout. */
void j2a_poll(void);

/* The second half: calls the function that a complete frame asks for and sends the reply, or
 * sends the pending error frame. */
void j2a_process(void);

#if J2A_WITH_SIF
/* Sends a server-initiated frame (SIF) on the link j2a_link: from within a function to the host that called it,
 * before the reply; elsewhere to the host of the link that j2a_link is set to, 0 to begin with. From the main
 * context only. Returns when the transmitter, or the port's buffer, has its last byte.
 * opcode: 0..255, what the host knows the frame by. With J2A_WITH_BOOT nothing is sent for 255, the opcode of
 * the boot SIF, nor while the link is down.
 * length: bytes of the payload, 0..255; J2A_ROOM does not limit it.
 * payload: where they are. */
void j2a_send_sif(uint8_t opcode, uint8_t length, const uint8_t *payload);
#endif

#if J2A_WITH_BOOT
/* An application may implement these, where compiler and linker know weak functions; they are asked once for each
 * link, when the boot SIF is sent.
 * Returns why the device began anew, J2A_BOOT_UNKNOWN to J2A_BOOT_SOFTWARE; without it the port tells. */
uint8_t j2a_boot_cause(void);
/* Returns the number of this start, from 1 on, and 1 again behind 65535; 0, as without it, where none is kept. */
uint16_t j2a_boot_count(void);
#endif

/* Adds to what a2jDebug gives the host. What does not fit is dropped, and the host is told that text was
 * lost. From the main context only.
 * text: UTF-8 that ends with NUL, in RAM. */
#if J2A_WITH_DEBUG
void j2a_debug(const char *text);
#else
#define j2a_debug(text) ((void)(text))
#endif

/* The self-test, if it is built in (J2A_WITH_SELFTEST). Called once, before j2a_port_init(). */
#if J2A_WITH_SELFTEST
void j2a_selftest(void);
#else
#define j2a_selftest() ((void)0)
#endif

/* The application implements: its share of the main loop; must return soon. */
void j2a_app_task(void);

#ifdef __cplusplus
}
#endif

#endif
