/* Build options of the firmware. Each is a -D of the compiler; the Makefile passes them
 * (OPTIONS="-DJ2A_WITH_SIF=0", RXBUF=64). Rules: 1 is on, 0 is off, and nothing else is
 * taken; every object file of one image sees the same values. */
#ifndef J2A_OPTIONS_H
#define J2A_OPTIONS_H

#include "j2a_const.h"

/* The optional parts of the protocol. Off, the functions of a part have no opcode and those behind them move
 * down, but opcode 0 stays reserved. */
/* From capabilities.toml by `python -m j2a_spec.generate`. */
/* Function map, a2jGetMapping and the names in flash. Off: opcode 0 is answered with 0xF0. */
#ifndef J2A_WITH_MAPPING
#define J2A_WITH_MAPPING 1
#endif

/* Data longer than a frame, a2jMany and a2jEchoMany. Off: the application's functions of kind many get no
 * opcode either, and there are no properties. */
#ifndef J2A_WITH_MANY
#define J2A_WITH_MANY 1
#endif

/* Properties, a2jGetProperties. Off: the device counts as one of version 1.0. */
#ifndef J2A_WITH_PROPERTIES
#define J2A_WITH_PROPERTIES J2A_WITH_MANY
#endif
#if J2A_WITH_PROPERTIES && !J2A_WITH_MANY
#error "J2A_WITH_PROPERTIES=1 needs J2A_WITH_MANY=1, by which properties are read"
#endif

/* Debug text, a2jDebug and j2a_debug(); costs J2A_DEBUGBUF + 5 bytes of RAM. Off: j2a_debug() does
 * nothing. */
#ifndef J2A_WITH_DEBUG
#define J2A_WITH_DEBUG 1
#endif

/* Server-initiated frames, j2a_send_sif(). Off: nothing is sent unasked. */
#ifndef J2A_WITH_SIF
#define J2A_WITH_SIF 1
#endif

/* Self-test by golden vectors at the start, with the property j2a.selftest; see J2A_SELFTEST_SMALL. Off:
 * j2a_selftest() does nothing. */
#ifndef J2A_WITH_SELFTEST
#define J2A_WITH_SELFTEST 0
#endif
#if J2A_WITH_SELFTEST && !J2A_WITH_PROPERTIES
#error "J2A_WITH_SELFTEST=1 needs J2A_WITH_PROPERTIES=1, because the result is a property"
#endif

/* Signatures of the functions, a2jGetInterface and their texts in flash. Off: functions have names only. */
#ifndef J2A_WITH_INTERFACE
#define J2A_WITH_INTERFACE 0
#endif
#if J2A_WITH_INTERFACE && !J2A_WITH_MAPPING
#error "J2A_WITH_INTERFACE=1 needs J2A_WITH_MAPPING=1, because hosts find it by both"
#endif
#if J2A_WITH_INTERFACE && !J2A_WITH_PROPERTIES
#error "J2A_WITH_INTERFACE=1 needs J2A_WITH_PROPERTIES=1, because hosts find it by both"
#endif

/* A SIF at the start, by which hosts notice a reset. Off: hosts do not notice each reset. */
#ifndef J2A_WITH_BOOT
#define J2A_WITH_BOOT 0
#endif
#if J2A_WITH_BOOT && !J2A_WITH_SIF
#error "J2A_WITH_BOOT=1 needs J2A_WITH_SIF=1, because a SIF tells the hash of the interface"
#endif
#if J2A_WITH_BOOT && !J2A_WITH_INTERFACE
#error "J2A_WITH_BOOT=1 needs J2A_WITH_INTERFACE=1, because a SIF tells the hash of the interface"
#endif

/* Sensors and actuators that describe themselves, transds_process(). Off: there is no transds_process(). */
#ifndef J2A_WITH_TRANSDUCERS
#define J2A_WITH_TRANSDUCERS 0
#endif
#if J2A_WITH_TRANSDUCERS && !J2A_WITH_SIF
#error "J2A_WITH_TRANSDUCERS=1 needs J2A_WITH_SIF=1, because samples are SIFs and hosts find them by both"
#endif
#if J2A_WITH_TRANSDUCERS && !J2A_WITH_MAPPING
#error "J2A_WITH_TRANSDUCERS=1 needs J2A_WITH_MAPPING=1, because samples are SIFs and hosts find them by both"
#endif
#if J2A_WITH_TRANSDUCERS && !J2A_WITH_PROPERTIES
#error "J2A_WITH_TRANSDUCERS=1 needs J2A_WITH_PROPERTIES=1, because samples are SIFs and hosts find them by both"
#endif

/* Settings of transducers that stay without power, SAVE. Off: each reset brings the settings of the
 * descriptors back. */
#ifndef J2A_WITH_SAVE
#define J2A_WITH_SAVE 0
#endif
#if J2A_WITH_SAVE && !J2A_WITH_TRANSDUCERS
#error "J2A_WITH_SAVE=1 needs J2A_WITH_TRANSDUCERS=1, whose settings it keeps"
#endif

/* A clock that the host disciplines, j2a_clock_us(). Off: the device has its local time only. */
#ifndef J2A_WITH_SYNC
#define J2A_WITH_SYNC 0
#endif
#if J2A_WITH_SYNC && !J2A_WITH_MAPPING
#error "J2A_WITH_SYNC=1 needs J2A_WITH_MAPPING=1, because hosts find it by both"
#endif
#if J2A_WITH_SYNC && !J2A_WITH_PROPERTIES
#error "J2A_WITH_SYNC=1 needs J2A_WITH_PROPERTIES=1, because hosts find it by both"
#endif

#if ((J2A_WITH_MAPPING | J2A_WITH_MANY | J2A_WITH_PROPERTIES | J2A_WITH_DEBUG | J2A_WITH_SIF | \
     J2A_WITH_SELFTEST | J2A_WITH_INTERFACE | J2A_WITH_BOOT | J2A_WITH_TRANSDUCERS | J2A_WITH_SAVE | \
     J2A_WITH_SYNC) & ~1) != 0
#error "J2A_WITH_... must be 0 or 1"
#endif

/* End of what is generated. */

/* The small self-test leaves the vectors of more than 96 bytes out: it takes about 8 kB of flash instead of
 * 23 kB, and 64 bytes of RAM as all of them do. */
#ifndef J2A_SELFTEST_SMALL
#define J2A_SELFTEST_SMALL 0
#endif

/* Links that the device serves at once, 1..255. Each takes J2A_ROOM, 9 to 13 bytes and what the port holds of RAM; see
 * j2a_link in j2a_port.h. A port must be made for it, such as those with ports/common/board.h. */
#ifndef J2A_LINKS
#define J2A_LINKS 1
#endif
#if J2A_LINKS < 1 || J2A_LINKS > 255
#error "J2A_LINKS must be 1..255"
#endif

/* The device's clock: j2a_port_time_us(). Off: it is not declared, and a port need not have it. */
#ifndef J2A_WITH_CLOCK
#define J2A_WITH_CLOCK 1
#endif

/* Bytes of debug text kept until the host takes them, 1..32767. */
#ifndef J2A_DEBUGBUF
#define J2A_DEBUGBUF 64
#endif
#if J2A_DEBUGBUF < 1 || J2A_DEBUGBUF > 32767
#error "J2A_DEBUGBUF must be 1..32767; debug text is switched off by J2A_WITH_DEBUG=0"
#endif

/* Received bytes that a port holds while a function runs; the property j2a.rxbuf announces this
 * number. On avr-serial 1..255, and it costs J2A_RXBUF + 1 bytes of RAM. */
#ifndef J2A_RXBUF
#define J2A_RXBUF 32
#endif

/* Room for the payload of a request, 32..255 bytes, and for a reply that is written over it. Longer requests are answered with 0xFF; with less
 * than 255 the device says so in its property j2a.room (J2A-LIMIT-006). */
#ifndef J2A_ROOM
#define J2A_ROOM J2A_MAX_PAYLOAD
#endif
#if J2A_ROOM < J2A_MIN_ROOM || J2A_ROOM > J2A_MAX_PAYLOAD
#error "J2A_ROOM must be 32..255 (J2A-LIMIT-006)"
#endif
#if J2A_WITH_SELFTEST && J2A_ROOM < J2A_MAX_PAYLOAD
#error "J2A_WITH_SELFTEST=1 needs J2A_ROOM=255: golden vectors are as long"
#endif
/* What J2A_ROOM leaves for the data of a chunk of a2jMany. */
#define J2A_ROOM_MANY (J2A_ROOM - J2A_MANY_HEADER)

/* Longest accepted pause between two bytes of a frame in milliseconds. */
#ifndef J2A_PAUSE_MS
#define J2A_PAUSE_MS J2A_BYTE_TIMEOUT_MS
#endif
#if J2A_PAUSE_MS < J2A_BYTE_TIMEOUT_MIN_MS || J2A_PAUSE_MS >= J2A_BYTE_TIMEOUT_MAX_MS
#error "J2A_PAUSE_MS must be 9..19 (J2A-TIME-001, J2A-TIME-002)"
#endif

/* Bytes that a port collects before it sends them, for ports on which many at once are cheaper than one by
 * one (posix, Arduino); 0 where a port has no such buffer. */
#ifndef J2A_TXBUF
#define J2A_TXBUF 0
#endif
#if J2A_RXBUF < 1 || J2A_TXBUF < 0
#error "J2A_RXBUF must be 1 or more, J2A_TXBUF 0 or more"
#endif

#if ((J2A_WITH_CLOCK | J2A_SELFTEST_SMALL) & ~1) != 0
#error "J2A_WITH_CLOCK and J2A_SELFTEST_SMALL must be 0 or 1"
#endif

#endif
