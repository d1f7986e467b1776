/* See board.h. */
#include "board.h"

#include <string.h>

#include "j2a_clock.h"

enum { ROOM = 8192 };

static const double IDLE_S = 0.001;
static const double NEVER = 1e300;

typedef struct {
    double time;
    uint8_t byte;
} timed_byte;

static struct {
    const double *rates, *phases;
    uint32_t count;
    double step;
} oscillator;
static struct {
    const double *starts;
    const uint16_t *numbers;
    uint32_t count, next;
    uint64_t seen;
    double late; /* when the interrupt of the next one comes */
    double captured; /* what the chip had counted at that of the last one, in its seconds */
    uint16_t number;
} frames;
static struct {
    const double *frame, *turn;
    uint32_t count, frame_next, turn_next;
    double cpu, reply, byte;
} delays;
static struct {
    const double *times;
    uint32_t count, next;
    uint64_t *clock;
    uint8_t *state, *epoch;
    uint32_t *uncertainty;
    uint64_t last, backwards;
    uint8_t last_epoch;
} readings;
static struct {
    uint8_t bytes[J2A_SYNCUSB_SIZE];
    bool is_there;
    double time; /* when it comes; NEVER: it has come */
} packet = {{0}, false, 1e300};
static timed_byte coming[ROOM], sent[ROOM];
static uint32_t coming_from, coming_to, arrived_to, sent_from, sent_to;
static double now, turn_at, wire_free;
static uint64_t turns;

/* ---- the chip ---- */

static double elapsed(double time) {
    const double place = time / oscillator.step;
    uint32_t at = (uint32_t)place;
    double past, slope = 0;
    if (at >= oscillator.count)
        at = oscillator.count - 1;
    else if (at + 1 < oscillator.count)
        slope = (oscillator.rates[at + 1] - oscillator.rates[at]) / oscillator.step;
    past = time - at * oscillator.step;
    return oscillator.phases[at] + past * (1 + oscillator.rates[at]) + slope * past * past / 2;
}

static void read_clock(void);

static double next_reading(void) {
    return readings.next < readings.count ? readings.times[readings.next] : NEVER;
}

/* The processor works on; an interrupt reads the clock when it is time to. */
static void pass(double seconds) {
    const double end = now + seconds;
    while (next_reading() <= end)
        read_clock();
    now = end;
}

uint64_t j2a_port_time_us(void) {
    pass(delays.cpu);
    return (uint64_t)(elapsed(now) * 1e6);
}

uint16_t j2a_port_ticks(void) {
    return (uint16_t)(uint64_t)(elapsed(now) * 2e6);
}

#if J2A_PORT_FRAMES
static void take_frame(void);

/* Timer 1 of the chip ticks each half microsecond. A frame that began since the turn has interrupted it. */
bool j2a_port_frame(j2a_frame *last) {
    pass(delays.cpu);
    while (frames.late <= now)
        take_frame();
    last->number = frames.number;
    last->began = (uint32_t)((uint64_t)(frames.captured * 2e6) << 3);
    return frames.seen != 0 && elapsed(now) - frames.captured < 0.1;
}
#endif

uint16_t j2a_port_overruns(void) {
    return 0;
}

void j2a_port_init(int argc, char **argv) {
    (void)argc;
    (void)argv;
}

int16_t j2a_port_rx(void) {
    return coming_from == arrived_to ? -1 : coming[coming_from++ % ROOM].byte;
}

void j2a_port_tx(uint8_t byte) {
    wire_free = (wire_free > now ? wire_free : now + delays.reply) + delays.byte;
    sent[sent_to++ % ROOM] = (timed_byte){wire_free, byte};
    if (sent_to - sent_from > ROOM)
        sent_from++;
}

void j2a_port_idle(void) {
#if J2A_PORT_FRAMES
    if (packet.is_there && packet.time == NEVER) {
        packet.is_there = false;
        j2a_clock_packet(packet.bytes);
    }
#endif
}

/* ---- what happens ---- */

static void read_clock(void) {
    const uint32_t at = readings.next++;
    const double kept = now, cpu = delays.cpu;
    now = readings.times[at];
    delays.cpu = 0;
    readings.clock[at] = j2a_clock_us();
    readings.state[at] = j2a_clock_state();
    readings.epoch[at] = j2a_clock_epoch();
    readings.uncertainty[at] = j2a_clock_uncertainty_us();
    if (readings.epoch[at] == readings.last_epoch && readings.clock[at] < readings.last)
        readings.backwards++;
    readings.last = readings.clock[at];
    readings.last_epoch = readings.epoch[at];
    delays.cpu = cpu;
    now = kept;
}

static void wake_main_loop(double time) {
    const double at = time + (delays.count ? delays.turn[delays.turn_next++ % delays.count] : 0);
    if (at < turn_at)
        turn_at = at;
}

/* The time of the interrupt of the next start of frame that is seen. */
static void find_frame(void) {
    while (frames.next < frames.count && (frames.numbers[frames.next] & BOARD_LOST))
        frames.next++;
    frames.late = NEVER;
    if (frames.next < frames.count)
        frames.late = frames.starts[frames.next] + (delays.count ? delays.frame[delays.frame_next++ % delays.count] : 0);
}

static void take_frame(void) {
    frames.captured = elapsed(frames.late);
    frames.number = frames.numbers[frames.next];
    frames.seen++;
    wake_main_loop(frames.late);
    frames.next++;
    find_frame();
}

static void take_turn(void) {
    now = turn_at > now ? turn_at : now;
    turn_at = now + IDLE_S;
    turns++;
    j2a_task();
    j2a_port_idle();
}

static double next_byte(void) {
    return arrived_to == coming_to ? NEVER : coming[arrived_to % ROOM].time;
}

void board_run(double until) {
    for (;;) {
        const double reading = next_reading(), byte = next_byte();
        double first = reading;
        if (byte < first)
            first = byte;
        if (frames.late < first)
            first = frames.late;
        if (packet.time < first)
            first = packet.time;
        if (turn_at < first)
            first = turn_at;
        if (first >= until)
            return;
        if (first == reading) {
            read_clock();
        } else if (first == frames.late) {
            take_frame();
        } else if (first == packet.time) {
            packet.time = NEVER;
            wake_main_loop(first);
        } else if (first == byte) {
            arrived_to++;
            wake_main_loop(byte);
        } else {
            take_turn();
        }
    }
}

/* ---- what the bench gives and takes ---- */

void board_oscillator(const double *rates, const double *phases, uint32_t count, double step) {
    oscillator.rates = rates;
    oscillator.phases = phases;
    oscillator.count = count;
    oscillator.step = step;
}

void board_frames(const double *starts, const uint16_t *numbers, uint32_t count) {
    frames.starts = starts;
    frames.numbers = numbers;
    frames.count = count;
}

void board_delays(const double *frame, const double *turn, uint32_t count, double cpu, double reply, double byte) {
    delays.frame = frame;
    delays.turn = turn;
    delays.count = count;
    delays.cpu = cpu;
    delays.reply = reply;
    delays.byte = byte;
}

void board_readings(const double *times, uint32_t count, uint64_t *clock, uint8_t *state, uint8_t *epoch,
                    uint32_t *uncertainty) {
    readings.times = times;
    readings.count = count;
    readings.clock = clock;
    readings.state = state;
    readings.epoch = epoch;
    readings.uncertainty = uncertainty;
}

void board_start(double time) {
    now = turn_at = wire_free = time;
    j2a_port_init(0, NULL);
    find_frame();
}

int board_receive(double first, double gap, const uint8_t *bytes, uint32_t count) {
    uint32_t i;
    if (coming_to - coming_from + count > ROOM)
        return -1;
    for (i = 0; i < count; i++)
        coming[coming_to++ % ROOM] = (timed_byte){first + gap * i, bytes[i]};
    return 0;
}

uint32_t board_frame_seen(double time) {
    uint64_t ticks, age_us;
    board_run(time);
    ticks = (uint64_t)(elapsed(time) * 2e6) - (uint64_t)(frames.captured * 2e6);
    if (frames.seen == 0 || ticks > J2A_CLOCK_FRAMES_MS * 2000u)
        return J2A_CLOCK_NO_FRAME;
    age_us = ticks / 2 < 0xFFFF ? ticks / 2 : 0xFFFF;
    return frames.number | (uint32_t)age_us << 16;
}

int board_packet(double time, const uint8_t *bytes) {
    if (packet.is_there)
        return -1;
    memcpy(packet.bytes, bytes, sizeof packet.bytes);
    packet.is_there = true;
    packet.time = time;
    return 0;
}

uint32_t board_sent(uint8_t *bytes, double *times, uint32_t room) {
    uint32_t n;
    for (n = 0; n < room && sent_from != sent_to; n++, sent_from++) {
        bytes[n] = sent[sent_from % ROOM].byte;
        times[n] = sent[sent_from % ROOM].time;
    }
    return n;
}

uint64_t board_backwards(void) {
    return readings.backwards;
}

uint64_t board_frames_seen(void) {
    return frames.seen;
}

uint64_t board_turns(void) {
    return turns;
}
