/* What the port in board_port.c asks of a board; the board.c of a port answers. Bytes of a UART, or of
 * anything else that keeps bytes in order, and a counter of milliseconds: no more is needed.
 * Rule: all of it is called from the main loop, but where BOARD_INTERRUPTS is 1 board_lost() and
 * board_read() are called by port_receive(), so from the receive interrupt. Where an interrupt of a driver gives values, it looks
 * at the clock: then board_ms() or board_us() is called from it, too, at any point of the main loop, and where BOARD_INTERRUPTS
 * is 0 so are board_has_byte(), board_lost() and board_read(), but not while the main loop is in one of these three. */
#ifndef BOARD_H
#define BOARD_H

#include <stdbool.h>
#include <stdint.h>

#include "j2a_port.h"

/* Sets up clock, UART (8 data bits, no parity, 1 stop bit) and millisecond counter, and switches
 * interrupts on where there are any. Called once. */
void board_init(void);

/* Has a byte been received that was not read yet? Not called where BOARD_INTERRUPTS is 1. */
bool board_has_byte(void);

/* Were bytes lost since the last call? That is the overrun flag of the UART, and this clears it, unless
 * reading the byte does. Called before each board_read(), because on many chips that moves the flag on.
 * Where it always says no, a frame with a hole in it can be taken for a good one, 1 time in 256. */
bool board_lost(void);

/* Takes the received byte; called only when there is one. */
uint8_t board_read(void);

/* Does the UART take a byte now? The port polls it, and goes on receiving meanwhile. Where it may say no for longer than a
 * character takes, as where the host must read first, it calls j2a_waiting(). */
bool board_can_write(void);

/* Sends a byte; called only after board_can_write() said yes. */
void board_write(uint8_t byte);

/* Milliseconds since the start, wrapping at 2^32 (not before: extend a counter of 16 bits), so each 49.7 days;
 * j2a_port_time_us() goes on counting if it is asked at least twice as often. Called in
 * each turn of the main loop, so a counter may be extended here if it wraps later than any function of
 * the application takes; with interrupts off, where one of a driver looks at the clock. One that an interrupt counts is read with interrupts off where the chip has
 * less than 32 bits. Not called, and need not be there, where BOARD_MICROSECONDS is 1. */
uint32_t board_ms(void);

/* Microseconds since the start, monotonic, without steps; legal in interrupts. Asked for where j2a_port_config.h defines
 * BOARD_MICROSECONDS as 1, in each turn of the main loop; elsewhere applications measure time by board_ms(). */
#ifndef BOARD_MICROSECONDS
#define BOARD_MICROSECONDS 0
#endif
#if BOARD_MICROSECONDS
uint64_t board_us(void);
#endif

/* Called in each turn of the main loop in which no received byte waits. Does nothing, or sends what board_write()
 * has collected (USB, an operating system), or sleeps until the next interrupt, at most for a millisecond. What
 * is collected must also go out when there is no room for more: bytes may come without end. */
void board_idle(void);

/* The port gives, where BOARD_INTERRUPTS is 1: call it from the receive interrupt, once for each byte. */
#if BOARD_INTERRUPTS
void port_receive(void);
#endif

/* The same where the board has several links: the interrupt of each names its own. Then the functions above
 * that read and write are about the link j2a_link, and board_init() sets all of them up. */
#if J2A_LINKS > 1
void port_receive_from(uint8_t link);
#endif

#endif
