/* A board of the bench: the core of the firmware as it is compiled for this machine, on a simulated chip.
 *
 * In:  what a crystal does, starts of frames, bytes with the true times of their arrival, and until when to run.
 * Out: bytes with their true times, and what the board's clock shows at given true times.
 * Rules: times are true seconds since the start of the run. The chip's counter is exact to the oscillator that is
 * given. Interrupts come late by what is given. The main loop takes a turn after an interrupt, as late as is given, and
 * at least each millisecond; between turns nothing happens, for a turn of an idle firmware changes nothing. Within a
 * turn the processor takes as long as is given for each reading of the counter. The clock is read at its times, in the
 * middle of a turn, too, as an interrupt would; that disturbs nothing. One copy of the library is one board.
 */
#ifndef BOARD_H
#define BOARD_H

#include <stdint.h>

/* The relative error of the oscillator at 0, step, 2 * step ..., and what it has counted by then in its own
 * seconds. All arrays that are given here stay with the caller, who keeps them. */
void board_oscillator(const double *rates, const double *phases, uint32_t count, double step);
enum { BOARD_LOST = 0x8000 };
/* Starts of frames: when they reach the board, and their numbers, plus BOARD_LOST for those that do not. */
void board_frames(const double *starts, const uint16_t *numbers, uint32_t count);
/* Delays, used one after the other, over and over: of the interrupt of a frame, and of the turn of the main loop behind
 * an interrupt. cpu: seconds that pass with each reading of the counter. reply: until the first byte of a frame is
 * on its way. byte: of one byte sent; 0: none. */
void board_delays(const double *frame, const double *turn, uint32_t count, double cpu, double reply, double byte);
/* Times at which to read the clock, rising, and where to put what it shows. */
void board_readings(const double *times, uint32_t count, uint64_t *clock, uint8_t *state, uint8_t *epoch,
                    uint32_t *uncertainty);
/* Bytes that arrive, the first one after `first` seconds, the others `gap` apart. Returns 0, or -1: no room. */
int board_receive(double first, double gap, const uint8_t *bytes, uint32_t count);
/* The request of SyncUSB comes at that time, on a board with USB. Returns the number of the frame, plus 2^16 times the
 * microseconds since its start. */
uint32_t board_frame_seen(double time);
/* A packet of SyncUSB comes at that time, on a board with USB. Returns 0, or -1: the last one was not taken yet. */
int board_packet(double time, const uint8_t *bytes);
/* Switches the board on, after all of the above; frames and readings before that time are not given. */
void board_start(double time);
/* Runs until then. */
void board_run(double until);
/* Takes what has been sent, at most `room` bytes, each with the time of its end. Returns how many. */
uint32_t board_sent(uint8_t *bytes, double *times, uint32_t room);
/* Readings that were below an earlier one of the same epoch. */
uint64_t board_backwards(void);
/* Starts of frames seen, and turns. */
uint64_t board_frames_seen(void);
uint64_t board_turns(void);

#endif
