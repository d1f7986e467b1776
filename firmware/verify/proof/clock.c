/* The clock, on a port with USB frames: one call of the application, of the main loop, of the host or of SyncUSB, from
 * any state that is sound. In: any local time, any frame, any request and packet; any contents of what is kept, but what
 * sound() says. Out: a state that is sound again. Since the first state is sound, every state is. */
#include "__fc_builtin.h"
#include "numbers.h"

/* Their functions are static. Before any.h, behind which volatile is what it says. */
#include "ext/j2a_clock.c"
#include "ext/j2a_clock_frames.c"

#include "any.h"

volatile uint8_t any_u8;
volatile uint16_t any_u16;
volatile uint32_t any_u32;

#include "any_numbers.h"

/* No line runs so much faster: 10000 ppm is what a host may ask for, and frames lead by less than 2 % (2^-32). */
#define MOST 0x8000000

/* ------------------------------------------------------------------------- the core's model ------ */

uint64_t j2a_port_time_us(void) {
    return (uint64_t)any_u32 << 32 | any_u32;
}

bool j2a_port_frame(j2a_frame *frame) {
    frame->number = any_u16 % J2A_CLOCK_FRAME_NUMBERS;
    frame->began = any_u32;
    return any_bool;
}

/* ------------------------------------------------------------------------- what is kept ------ */

static int32_t within(int32_t most) {
    const int32_t number = (int32_t)any_u32;
    return number >= -most && number <= most ? number : 0;
}

static void forget_line(j2a_line *line, int32_t rate, int32_t correction) {
    line->at = any_u32;
    line->part = any_u32;
    line->time_us = j2a_port_time_us();
    line->rate = within(rate);
    line->correction = within(correction);
}

static void forget_all(void) {
    const int32_t runs = within(RUNAWAY - 1);
    forget_line(&lines[0], MOST, MAX_CORRECTION);
    forget_line(&lines[1], MOST, MAX_CORRECTION);
    forget_line(&target, MOST, 0);
    forget_line(&host, MAX_RATE, 0);
    current = any_bool;
    epoch = any_u8;
    is_told = any_bool;
    was_step = any_bool;
    adjusted_us = j2a_port_time_us();
    given_us = any_u32;
    wander = any_u32;
    frame_us = any_u32;
    j2a_received_us = j2a_port_time_us();
    has_phase = any_bool;
    gear = any_u8 % GEARS;
    in_gear = any_u8;
    runaway = (int8_t)runs;
    frame = any_u32;
    began = any_u32;
    phase = any_u32;
    period = any_u32;
    if (period < PERIOD - PERIOD / 64 || period > PERIOD + PERIOD / 64)
        period = PERIOD;
    told = any_bool;
    told_frame = any_u32;
    told_span = any_u32;
}

static void check_line(const j2a_line *line) {
    //@ check -MOST <= line->rate <= MOST;
    //@ check -MAX_CORRECTION <= line->correction <= MAX_CORRECTION;
    (void)line;
}

static void check_all(void) {
    check_line(&lines[0]);
    check_line(&lines[1]);
    check_line(&target);
    //@ check -MAX_RATE <= host.rate <= MAX_RATE && host.correction == 0 && target.correction == 0;
    //@ check current <= 1 && gear < GEARS && -RUNAWAY < runaway < RUNAWAY;
    //@ check PERIOD - PERIOD / 64 <= period <= PERIOD + PERIOD / 64;
}

/* ------------------------------------------------------------------------- calls ------ */

static void ask(void) {
    uint8_t room[J2A_ROOM];
    uint8_t *payload = room;
    uint8_t length = any_u8;
    uint8_t item = any_u8;
    uint8_t code;
    if (length > J2A_ROOM)
        return;
    if (item > J2A_CLOCK_FRAME)
        item = J2A_CLOCK_FRAME + 1;
    Frama_C_make_unknown((char *)room, sizeof room);
    //@ split item;
    room[0] = item;
    code = j2a_clock(&length, &payload);
    //@ check code <= J2A_CLOCK_BAD_VALUE;
    //@ check code == 0 || length == 0;
    //@ check payload == (uint8_t *)room && length <= J2A_ROOM;
    (void)code;
}

static void get_packet(void) {
    uint8_t packet[J2A_SYNCUSB_SIZE];
    Frama_C_make_unknown((char *)packet, sizeof packet);
    j2a_clock_packet(packet);
}

static void read(void) {
    (void)j2a_clock_us();
    (void)j2a_clock_is_due(j2a_port_time_us());
    (void)j2a_clock_epoch();
    (void)j2a_clock_uncertainty_us();
}

static void tell_state(void) {
    const uint8_t state = j2a_clock_state();
    //@ check state <= J2A_CLOCK_HOLDOVER;
    (void)state;
}

int main(void) {
    check_all();
    forget_all();
    switch (any_u8) {
    case 0:
        read();
        break;
    case 1:
        tell_state();
        break;
    case 2:
        ask();
        break;
    case 3:
        get_packet();
        break;
    default:
        j2a_clock_turn();
    }
    check_all();
    return 0;
}
