/* The clock that the host disciplines (SPEC.md, section 23; J2A_WITH_SYNC).
 * In: the local time of the port, lines of the host by a2jClock, and on a port with USB frames their begins. Out:
 * the time, which follows these lines without a jump.
 * Rules: j2a_clock_us() may be called from an interrupt at any point, all else from the main context only. The main
 * loop calls j2a_poll() at least each 30 minutes, and no interrupt takes longer than half a millisecond.
 * The core needs of this port j2a_port_time_us(), legal in interrupts, and j2a_port_frame() if J2A_PORT_FRAMES is 1;
 * who compiles ext/j2a_clock*.c alone adds j2a_get_u32() and j2a_put_u32() of j2a_numbers.h, sets j2a_received_us
 * before j2a_clock() and calls j2a_clock_turn() about each millisecond. */
#ifndef J2A_CLOCK_H
#define J2A_CLOCK_H

#include "j2a.h"

/* 1 in the j2a_port_config.h of a port that has USB frames. */
#ifndef J2A_PORT_FRAMES
#define J2A_PORT_FRAMES 0
#endif

#if J2A_WITH_SYNC

#ifdef __cplusplus
extern "C" {
#endif

/* ------------------------------------------------------------------ for applications --------- */

/* Returns the time in microseconds: since 1970-01-01 00:00 UTC, or the local time while the clock is free. */
uint64_t j2a_clock_us(void);

/* Returns J2A_CLOCK_FREE, J2A_CLOCK_SETTLING, J2A_CLOCK_LOCKED or J2A_CLOCK_HOLDOVER. */
uint8_t j2a_clock_state(void);

/* Returns the epoch, 0 while the clock is free. */
uint8_t j2a_clock_epoch(void);

/* Returns the bound of the error in microseconds, J2A_CLOCK_UNKNOWN if it is unknown. */
uint32_t j2a_clock_uncertainty_us(void);

/* ------------------------------------------------------------------ for ports ---------------- */

/* A port that has a counter for it waits more exactly: J2A_PORT_WAIT 1 in its j2a_port_config.h. From the main context;
 * interrupts may be off for the last 20 us.
 * local_us: the lower 32 bits of a local time that is at most a millisecond ahead. */
#ifndef J2A_PORT_WAIT
#define J2A_PORT_WAIT 0
#endif
#if J2A_PORT_WAIT
void j2a_port_wait(uint32_t local_us);
#endif

/* Returns the upper 32 bits of a * b, rounded down; *low: the others. A port of a processor that does not multiply may have a
 * shorter one: J2A_PORT_PRODUCT 1 in its j2a_port_config.h; legal in interrupts.
 * a: between -2^30 and 2^30. */
#ifndef J2A_PORT_PRODUCT
#define J2A_PORT_PRODUCT 0
#endif
#if J2A_PORT_PRODUCT
int32_t j2a_port_product(int32_t a, int32_t b, uint32_t *low);
#define j2a_product j2a_port_product
#else
J2A_INLINE int32_t j2a_product(int32_t a, int32_t b, uint32_t *low) {
    const int64_t product = (int64_t)a * b;
    *low = (uint32_t)product;
    return (int32_t)(product >> 32);
}
#endif

#if J2A_PORT_FRAMES
/* The start of a USB frame. */
typedef struct {
    uint16_t number; /* of the frame, 0 to 2047 */
    uint32_t began;  /* local time in sixteenths of a microsecond, the lower 32 bits */
} j2a_frame;

/* The port implements: the last start of frame that it saw. From the main context.
 * Returns false if it saw none in the last 100 ms. */
bool j2a_port_frame(j2a_frame *last);

/* A packet of SyncUSB, see J2A_SYNCUSB_SIZE; ignores what it cannot use (SYNC-006). */
void j2a_clock_packet(const uint8_t *packet);
#endif

/* ------------------------------------------------------------------ for the core ------------- */

/* The local time at which the request that is executed was received. */
extern uint64_t j2a_received_us;

/* Leads the time to its target; about each millisecond. */
void j2a_clock_turn(void);

/* Returns whether a time has come. If that is a little ahead waits for it, so that what then happens does so on
 * several boards at once, however long their main loops take. */
bool j2a_clock_is_due(uint64_t due_us);

/* The function a2jClock. */
J2A_DECLARE_CALL(j2a_clock);

/* Moves what waits for its time; the part transducers implements it. */
#if J2A_WITH_TRANSDUCERS
void j2a_transds_move(uint64_t by_us);
#endif

/* A line: `time_us` and `part` at `at`, and from there the rate. */
typedef struct {
    uint32_t at;        /* the lower 32 bits of what it is over, such as the local time, in microseconds */
    uint32_t part;      /* of a microsecond, in 2^-32 */
    uint64_t time_us;
    int32_t rate;       /* by which the time runs faster, in 2^-32 */
    int32_t correction; /* more of it, up to J2A_SEGMENT_US behind `at` */
} j2a_line;

/* Moves the start of a line without a correction by less than 2^31 us. */
void j2a_line_move(j2a_line *line, int32_t by_us);

#if J2A_PORT_FRAMES
/* Follows the frames; about each millisecond. */
void j2a_frames_turn(void);

/* A frame of that number, modulo 1024, began at that time. Returns whether there are frames. */
bool j2a_frames_told(uint64_t time_us, uint16_t number);

/* Puts the line of the frames over the local time into *target, unless it is not known. */
void j2a_frames_target(j2a_line *target, uint32_t now);

/* Forgets what the host told of frames. */
void j2a_frames_forget(void);

/* Writes number and age of the last frame at a local time that has just been: 4 bytes. */
void j2a_frames_put(uint8_t *bytes, uint32_t local);
#endif

#ifdef __cplusplus
}
#endif

#endif

#endif
