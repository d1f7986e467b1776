/* THE contract between the core and a port: link-time functions, no pointers to register.
 * Bytes of the link flow in through j2a_port_rx() (or are pushed with j2a_rx_byte()) and flow out
 * through j2a_port_tx(). Rules: the core calls these only from j2a_poll(), j2a_process() and
 * j2a_send_sif(), so from the one context in which the application calls those, which also calls the rest of
 * them; j2a_port_ticks() from j2a_rx_byte(), too, and with J2A_WITH_SYNC j2a_port_time_us(); and that one also where a
 * driver gives a value, which may be an interrupt. */
#ifndef J2A_PORT_H
#define J2A_PORT_H

#include <stdbool.h>
#include <stdint.h>

#include "j2a_options.h"

/* The link that is served, 0..J2A_LINKS-1. Where there is more than one, j2a_task() sets it before it
 * calls anything below, and so may the main context. An interrupt that pushes bytes with j2a_rx_byte() sets
 * it for that call, and then back. */
#if J2A_LINKS > 1
extern uint8_t j2a_link;
#else
#define j2a_link 0
#endif

/* ------------------------------------------------------------------ the port implements ------ */

#include "j2a_port_config.h"

/* Ticks of j2a_port_ticks() in a millisecond, rounded up; in the port's j2a_port_config.h. With 1 a pause ends
 * a frame after 10 to 12 ms, with about 10 after 10.1 to 10.3; many more are no better, because a pause is
 * missed when 65536 ticks pass between two calls of j2a_poll(). */
#ifndef J2A_TICKS_PER_MS
#error "the port's j2a_port_config.h must define J2A_TICKS_PER_MS"
#endif

/* Links that the port has, which is the most that J2A_LINKS may be. A port with more than one says so in its
 * j2a_port_config.h. */
#ifndef J2A_PORT_LINKS
#define J2A_PORT_LINKS 1
#endif
#if J2A_LINKS > J2A_PORT_LINKS
#error "J2A_LINKS (make LINKS=) is more than this port has, see J2A_PORT_LINKS"
#endif

/* Whether somebody may be there to receive: the boot SIF waits for it (J2A-BOOT-001). A port that knows when a
 * host comes, such as one with USB, says so in its j2a_port_config.h. */
#ifndef J2A_PORT_IS_UP
#define J2A_PORT_IS_UP true
#endif

/* Sample SIFs are put together in the room for requests, where they wait while one is being received, instead of on the
 * stack. A port none of whose interrupts calls j2a_rx_byte() may say so in its j2a_port_config.h. */
#ifndef J2A_PORT_SHARES_ROOM
#define J2A_PORT_SHARES_ROOM 0
#endif

#ifdef __cplusplus
extern "C" {
#endif

/* Sets the link and the clocks up. A port without a command line ignores the arguments. */
void j2a_port_init(int argc, char **argv);

/* Takes and returns the oldest received byte, or returns -1 when there is none. Never waits. Before
 * it first returns a byte that arrived after a loss, it calls j2a_rx_lost(). */
int16_t j2a_port_rx(void);

/* Sends one byte; waits while the transmit buffer is full, even with interrupts off. See j2a_waiting(). */
void j2a_port_tx(uint8_t byte);

/* Time in ticks, free-running, wrapping at 65536. */
uint16_t j2a_port_ticks(void);

/* Time since the start in microseconds, monotonic, without steps. Legal in interrupts, at any point of the main context, which
 * may be in this function itself. */
#if J2A_WITH_CLOCK
uint64_t j2a_port_time_us(void);
#endif

/* A time that costs an interrupt little, for values of drivers; a port that has it defines J2A_PORT_STAMP 1 in its
 * j2a_port_config.h. j2a_port_stamp() may be called in any interrupt; it writes J2A_STAMP_BYTES bytes, the last one not 0.
 * j2a_port_stamp_us() returns the j2a_port_time_us() of that moment, however long ago it was. */
#ifndef J2A_PORT_STAMP
#define J2A_PORT_STAMP 0
#endif
#if J2A_PORT_STAMP && J2A_WITH_TRANSDUCERS
enum { J2A_STAMP_BYTES = 8 };
void j2a_port_stamp(volatile uint8_t *stamp);
uint64_t j2a_port_stamp_us(const uint8_t *stamp);
#endif

/* Times that received bytes were lost because the device was too slow, since the start. */
uint16_t j2a_port_overruns(void);

/* Bytes that stay without power, for J2A_WITH_SAVE: J2A_PORT_KEPT_BYTES of them, a number that a port with such memory
 * defines in its j2a_port_config.h. j2a_port_kept() returns one. j2a_port_keep() returns true if it is `byte`;
 * otherwise it begins to write it, unless it is writing one already, and returns false: it is called again later. */
#if J2A_WITH_SAVE
uint8_t j2a_port_kept(uint16_t at);
bool j2a_port_keep(uint16_t at, uint8_t byte);
#endif

/* Called in each turn of the main loop: may sleep for about a millisecond when nothing has been
 * received, may end the program where programs end. */
void j2a_port_idle(void);

/* ------------------------------------------------------------------ the port calls ----------- */

/* Pushes one received byte into the parser; j2a_poll() does so with what j2a_port_rx() returns.
 * Never waits and sends nothing, so a port may push from its interrupt instead: j2a_poll() then runs with that
 * interrupt off. Returns false, and takes no byte, while a frame or an error waits for j2a_process(): let
 * j2a_port_rx() return that byte later, or call j2a_rx_lost(). */
bool j2a_rx_byte(uint8_t byte);

/* Sets actuators to safe whose watchdog has run out, and does what SET and TRIGGER have asked for by now: a port calls it
 * again and again while it waits to send for longer than a character takes, as where a host does not read. Sends nothing,
 * but calls the functions of drivers. From the main context. */
#if J2A_WITH_TRANSDUCERS
void j2a_waiting(void);
#else
#define j2a_waiting() ((void)0)
#endif

/* Says that bytes were lost between the last byte pushed and the next one. */
void j2a_rx_lost(void);

#ifdef __cplusplus
}
#endif

#endif
