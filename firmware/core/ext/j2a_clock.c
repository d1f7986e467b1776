/* The clock: time = time at an anchor + local time since then * (1 + rate), in fixed point (SPEC.md, section 23).
 * In: adjustments of the host, which set a target line, and the local time. Out: j2a_clock_us(), a2jClock.
 * Rules: integers only, no division. Readers may be interrupts and take no lock: there are two lines, the main
 * context writes the one that is not in use, with its begin a little ahead, and then says by one byte that it
 * holds. Until its begin readers use the old one, so the two meet there, and the time never goes back. */
#include "j2a_clock.h"

#if J2A_WITH_SYNC

#if !J2A_WITH_CLOCK
#error "J2A_WITH_SYNC=1 needs J2A_WITH_CLOCK=1, the local time"
#endif

enum {
    LEAD_US = 1024,       /* from the plan of a line to its begin */
    MARGIN_US = 512,      /* so much earlier it holds; interrupts are shorter */
    WAIT_US = 1000,       /* a turn of the main loop is shorter */
    DISTANCE_BITS = 12,   /* a correction of n / 2^32 over a segment removes n / 2^12 us */
    STATUS_BYTES = 26
};
#define MAX_CORRECTION 4294967L /* 1000 ppm, in 2^-32 */
#define SEGMENT_US 1048576L /* 2^20: a correction removes the distance in so long */
#define FAR_US (1LL << 40)  /* larger distances count as this one, so that none overflows */

static volatile j2a_line lines[2];
static volatile uint8_t current; /* the line that holds from its begin on; before, the other one */
static volatile uint8_t epoch;
static j2a_line target; /* without a correction */
static bool is_told;        /* the target is another one since the last plan */
static bool was_step;       /* the last adjustment was one */
static uint64_t adjusted_us; /* local time of the last adjustment */
static uint32_t given_us;   /* its uncertainty */
static uint32_t wander;     /* its wander in 2^-38 */
#if J2A_PORT_FRAMES
static uint32_t frame_us = J2A_CLOCK_UNKNOWN; /* the uncertainty of packets: that of the last FRAME */
#endif
uint64_t j2a_received_us;

/* ------------------------------------------------------------------------- lines ------ */

/* Returns the time on a line. *part: what is left, in 2^-32 us. In 32 bits, because the stack of an AVR holds what 64 have
 * no registers for, and this may run in an interrupt. */
static J2A_NOINLINE uint64_t time_on(const volatile j2a_line *line, uint32_t now, uint32_t *part) {
    uint32_t passed = now - line->at;
    uint32_t sum = line->part;
    uint32_t low;
    if (passed < SEGMENT_US) {
        passed += (uint32_t)j2a_product(line->rate + line->correction, (int32_t)passed, &low);
    } else {
        passed += (uint32_t)j2a_product(line->rate, (int32_t)passed, &low);
        sum += low;
        passed += sum < low;
        passed += (uint32_t)j2a_product(line->correction, SEGMENT_US, &low);
    }
    sum += low;
    passed += sum < low;
    *part = sum;
    return line->time_us + passed;
}

J2A_NOINLINE void j2a_line_move(j2a_line *line, int32_t by_us) {
    uint32_t low;
    uint32_t sum_us = (uint32_t)by_us + (uint32_t)j2a_product(line->rate, by_us, &low);
    line->part += low;
    sum_us += line->part < low;
    line->time_us += (uint64_t)(int32_t)sum_us;
    line->at += (uint32_t)by_us;
}

/* Returns the line that holds at a local time, which is now or later. It stays as it is: in an interrupt because the main
 * context waits, and in the main context until its next plan. */
static J2A_NOINLINE const volatile j2a_line *line_at(uint32_t now) {
    const uint8_t which = current;
    return &lines[(int32_t)(now - lines[which].at) < 0 ? which ^ 1 : which];
}

static J2A_NOINLINE uint64_t time_at(uint32_t now) {
    uint32_t part;
    return time_on(line_at(now), now, &part);
}

/* Apart, because 64 bits cost the stack of an AVR much, wherever they are. */
static J2A_NOINLINE uint32_t local_time(void) {
    return (uint32_t)j2a_port_time_us();
}

uint64_t j2a_clock_us(void) {
    return epoch == 0 ? j2a_port_time_us() : time_at(local_time());
}

#if !J2A_PORT_WAIT
static void j2a_port_wait(uint32_t local_us) {
    while ((int32_t)((uint32_t)j2a_port_time_us() - local_us) < 0) {
    }
}
#endif

/* The lower 32 bits, enough for what is less than a millisecond ahead. */
static J2A_NOINLINE uint32_t low_time_at(uint32_t now) {
    return epoch == 0 ? now : (uint32_t)time_at(now);
}

/* Looks for the local time at which it is due before the wait, because a look behind it would take its time on each board.
 * The time may run faster than the local time, so a step is a little short, and another line may begin meanwhile. */
bool j2a_clock_is_due(uint64_t due_us) {
    const uint64_t local_us = j2a_port_time_us();
    uint32_t then = (uint32_t)local_us;
    const uint64_t time_us = epoch == 0 ? local_us : time_at(then);
    uint64_t ahead_us;
    int32_t left_us;

    if (due_us <= time_us)
        return true;
    ahead_us = due_us - time_us;
    if (ahead_us > WAIT_US)
        return false;
    left_us = (int32_t)ahead_us;
    do {
        then += (uint32_t)(left_us - left_us / 64);
        left_us = (int32_t)((uint32_t)due_us - low_time_at(then));
    } while (left_us > 0);
    j2a_port_wait(then);
    return true;
}

/* Returns target less time at a local time, in 2^-12 us; moves the target there. */
static J2A_NOINLINE int64_t distance(uint32_t now, const volatile j2a_line *line) {
    uint32_t part;
    int64_t whole_us;
    j2a_line_move(&target, (int32_t)(now - target.at));
    whole_us = (int64_t)(target.time_us - time_on(line, now, &part));
    if (whole_us > FAR_US)
        whole_us = FAR_US;
    if (whole_us < -FAR_US)
        whole_us = -FAR_US;
    return whole_us * (1 << DISTANCE_BITS) + (int32_t)(target.part >> (32 - DISTANCE_BITS))
           - (int32_t)(part >> (32 - DISTANCE_BITS));
}

/* Plans the next line: from a little ahead on, and to the target in a segment or at 1000 ppm. */
static J2A_NOINLINE void plan(uint32_t now) {
    const uint8_t next = current ^ 1;
    const uint32_t begin = now + LEAD_US;
    j2a_line line;
    int64_t off;

    line = *line_at(begin);
    off = distance(begin, &line);
    line.time_us = time_on(&line, begin, &line.part);
    line.at = begin;
    line.rate = target.rate;
    line.correction = (int32_t)(off > MAX_CORRECTION ? MAX_CORRECTION : off < -MAX_CORRECTION ? -MAX_CORRECTION : off);
    lines[next] = line;
    if ((int32_t)(begin - MARGIN_US - (uint32_t)j2a_port_time_us()) < 0)
        return; /* too late, something took long: whoever turns plans anew */
    current = next;
    is_told = false;
}

void j2a_clock_turn(void) {
    uint32_t now;
    int32_t passed;
#if J2A_PORT_FRAMES
    j2a_frames_turn();
#endif
    if (epoch == 0)
        return;
    now = (uint32_t)j2a_port_time_us();
    passed = (int32_t)(now - lines[current].at);
    if (passed >= 0 && (is_told || passed >= SEGMENT_US - LEAD_US)) {
#if J2A_PORT_FRAMES
        j2a_frames_target(&target, now);
#endif
        plan(now);
    }
}

/* Sets the time to the target at once. A line whose begin is ahead was not used by any reader. */
static J2A_NOINLINE void step(uint64_t now_us) {
    const uint64_t before_us = epoch != 0 ? time_at((uint32_t)now_us) : now_us;
    if (epoch != 0 && (int32_t)((uint32_t)now_us - lines[current].at) < 0)
        current ^= 1;
    lines[current ^ 1] = target;
    current ^= 1;
    epoch = (uint8_t)(epoch == 255 ? 1 : epoch + 1);
    is_told = false;
#if J2A_WITH_TRANSDUCERS
    j2a_transds_move(target.time_us - before_us);
#else
    (void)before_us;
#endif
}

/* ------------------------------------------------------------------------- what is known ------ */

/* Returns |target less time|, rounded up to microseconds. */
static J2A_NOINLINE uint64_t error_us(uint32_t now) {
    const int64_t off = distance(now, line_at(now));
    return (uint64_t)((off < 0 ? -off : off) + (1 << DISTANCE_BITS) - 1) >> DISTANCE_BITS;
}

static J2A_NOINLINE uint8_t state_at(uint64_t now_us) {
    const uint32_t known_us = given_us == J2A_CLOCK_UNKNOWN ? 0 : given_us;
    if (epoch == 0)
        return J2A_CLOCK_FREE;
    if (now_us - adjusted_us >= J2A_CLOCK_HOLDOVER_S * 1000000UL)
        return J2A_CLOCK_HOLDOVER;
    if (was_step || error_us((uint32_t)now_us) > (known_us > J2A_CLOCK_SETTLED_US ? known_us : J2A_CLOCK_SETTLED_US))
        return J2A_CLOCK_SETTLING;
    return J2A_CLOCK_LOCKED;
}

/* Returns by how much the time may have wandered, rounded up to microseconds: passed_us * wander / 2^38, first by 2^32. */
static J2A_NOINLINE uint64_t wandered_us(uint64_t passed_us) {
    const uint64_t low = (uint64_t)(uint32_t)passed_us * wander >> 32;
    return (((passed_us >> 32) * wander + low) >> 6) + (wander != 0);
}

static J2A_NOINLINE uint32_t uncertainty_at(uint64_t now_us) {
    uint64_t sum_us;
    if (epoch == 0 || given_us == J2A_CLOCK_UNKNOWN)
        return J2A_CLOCK_UNKNOWN;
    sum_us = wandered_us(now_us - adjusted_us);
    sum_us += given_us + error_us((uint32_t)now_us);
    return sum_us < J2A_CLOCK_UNKNOWN ? (uint32_t)sum_us : J2A_CLOCK_UNKNOWN;
}

uint8_t j2a_clock_state(void) {
    return state_at(j2a_port_time_us());
}

uint8_t j2a_clock_epoch(void) {
    return epoch;
}

uint32_t j2a_clock_uncertainty_us(void) {
    return uncertainty_at(j2a_port_time_us());
}

static J2A_NOINLINE void put_times(uint8_t *bytes, uint64_t now_us) {
    const uint32_t now = (uint32_t)now_us;
    uint64_t time_us = now_us;
    int32_t rate = 0;
    j2a_line line;

    if (epoch != 0) {
        time_us = time_at(now);
        line = lines[current]; /* also before its begin: what the host was told last is how the time goes on */
        rate = line.rate + ((int32_t)(now - line.at) < SEGMENT_US ? line.correction : 0);
    }
    j2a_put_u64(bytes, now_us);
    j2a_put_u64(bytes + 8, time_us);
    j2a_put_i32(bytes + 18, (int32_t)(((int64_t)rate * 1000000000 + 0x80000000LL) >> 32));
}

static J2A_NOINLINE void put_status(uint8_t *bytes) {
    const uint64_t now_us = j2a_port_time_us();
    put_times(bytes, now_us);
    bytes[16] = state_at(now_us);
    bytes[17] = epoch;
    j2a_put_u32(bytes + 22, uncertainty_at(now_us));
}

/* ------------------------------------------------------------------------- what the host says ------ */

/* What the host knows of the target, which is set at now_us. */
static J2A_NOINLINE void note(uint64_t now_us, uint32_t uncertainty_us, uint32_t wander_ppb) {
    adjusted_us = now_us;
    given_us = uncertainty_us;
    wander = (uint32_t)(((uint64_t)wander_ppb * 288230377 + 0xFFFFF) >> 20);
}

/* Because the reply tells the rate of the next line. Apart and without a loop, as the stack of an AVR is deepest here. */
static J2A_NOINLINE void plan_at_once(void) {
    is_told = true;
    j2a_clock_turn();
    if (is_told) /* it was too late */
        j2a_clock_turn();
    if (is_told)
        j2a_clock_turn();
}

/* The target has been set, at adjusted_us. */
static J2A_NOINLINE void adjust(bool is_step) {
    was_step = is_step || epoch == 0;
    if (was_step) {
        step(adjusted_us);
    } else {
        const uint32_t begin = lines[current].at;
        if (begin - (uint32_t)adjusted_us <= LEAD_US) { /* ahead: it passes first, so that the next line is planned at once */
            j2a_port_wait(begin);
            adjusted_us = j2a_port_time_us();
        }
        plan_at_once();
    }
}

/* Sets the target to a line, if its fields are in range; returns the code. */
static J2A_NOINLINE uint8_t take_line(const uint8_t *bytes, uint64_t now_us) {
    const uint64_t local_us = j2a_get_u64(bytes + 2);
    const uint64_t time_us = j2a_get_u64(bytes + 10);
    const int32_t rate = j2a_get_i32(bytes + 18);
    const uint32_t wander_ppb = j2a_get_u32(bytes + 26);
    const uint32_t behind_us = (uint32_t)(now_us - local_us);

    if (bytes[1] > J2A_CLOCK_STEP || local_us > now_us || now_us - local_us > J2A_CLOCK_MAX_BEHIND || time_us >> 63 != 0
        || rate > (int32_t)J2A_CLOCK_MAX_RATE || rate < -(int32_t)J2A_CLOCK_MAX_RATE || wander_ppb > J2A_CLOCK_MAX_RATE)
        return J2A_CLOCK_BAD_VALUE;
#if J2A_PORT_FRAMES
    j2a_frames_forget();
    frame_us = J2A_CLOCK_UNKNOWN;
#endif
    target.at = (uint32_t)local_us;
    target.time_us = time_us;
    target.part = 0;
    target.rate = (int32_t)(((int64_t)rate * 1152921505 + 0x8000000) >> 28);
    j2a_line_move(&target, (int32_t)(behind_us / 2)); /* in two steps, because 2^31 us are too many for one */
    j2a_line_move(&target, (int32_t)(behind_us - behind_us / 2));
    return 0;
}

static J2A_NOINLINE uint8_t adjust_line(const uint8_t *bytes) {
    const uint64_t now_us = j2a_port_time_us();
    const uint8_t code = take_line(bytes, now_us);
    if (code == 0) {
        note(now_us, j2a_get_u32(bytes + 22), j2a_get_u32(bytes + 26));
        adjust(bytes[1] == J2A_CLOCK_STEP);
    }
    return code;
}

#if J2A_PORT_FRAMES
/* Sets the target by the frames; returns whether it is so far that the time has to step. */
static J2A_NOINLINE bool aim(uint32_t now) {
    const int64_t limit = (int64_t)J2A_CLOCK_FRAME_STEP_S * 1000000 << DISTANCE_BITS;
    int64_t off;
    j2a_frames_target(&target, now);
    off = distance(now, epoch != 0 ? line_at(now) : &target);
    return off >= limit || off <= -limit;
}

static J2A_NOINLINE uint8_t adjust_frame(uint64_t time_us, uint16_t number, uint32_t uncertainty_us) {
    const uint64_t now_us = j2a_port_time_us();
    bool is_step;

    if (number >= J2A_CLOCK_FRAME_NUMBERS || time_us >> 63 != 0 || !j2a_frames_told(time_us, number))
        return J2A_CLOCK_BAD_VALUE;
    is_step = aim((uint32_t)now_us);
    frame_us = uncertainty_us;
    note(now_us, uncertainty_us, J2A_CLOCK_FRAME_WANDER);
    adjust(is_step);
    return 0;
}

void j2a_clock_packet(const uint8_t *packet) {
    (void)adjust_frame(j2a_get_u64(packet), j2a_get_u16(packet + 8), frame_us);
}
#endif

static J2A_NOINLINE uint8_t exchange(uint8_t *bytes) {
    const uint32_t received = (uint32_t)j2a_received_us;
    uint32_t turnaround_us;
    uint8_t i;
    for (i = 0; i < 4; i++)
        bytes[i] = bytes[i + 1];
    j2a_put_u64(bytes + 4, j2a_received_us);
#if J2A_PORT_FRAMES
    j2a_frames_put(bytes + 14, received);
#endif
    turnaround_us = (uint32_t)j2a_port_time_us() - received;
    j2a_put_u16(bytes + 12, (uint16_t)(turnaround_us < J2A_CLOCK_MAX_TURNAROUND ? turnaround_us
                                                                               : J2A_CLOCK_MAX_TURNAROUND));
    return 14 + 4 * J2A_PORT_FRAMES;
}

uint8_t j2a_clock(uint8_t *const length, uint8_t **const payload) {
    static const uint8_t J2A_FLASH sizes[] = {5, 1, 30, 15};
    uint8_t *const bytes = *payload;
    const uint8_t count = *length;
    const uint8_t item = bytes[0];
    uint8_t code = 0;

    *length = 0;
    if (count == 0)
        return J2A_CLOCK_BAD_LENGTH;
    if (item > (J2A_PORT_FRAMES ? J2A_CLOCK_FRAME : J2A_CLOCK_ADJUST))
        return J2A_CLOCK_NO_ITEM;
    if (count != j2a_flash_u8(&sizes[item]))
        return J2A_CLOCK_BAD_LENGTH;
    if (item == J2A_CLOCK_EXCHANGE) {
        *length = exchange(bytes);
        return 0;
    }
    if (item == J2A_CLOCK_ADJUST)
        code = adjust_line(bytes);
#if J2A_PORT_FRAMES
    if (item == J2A_CLOCK_FRAME)
        code = adjust_frame(j2a_get_u64(bytes + 1), j2a_get_u16(bytes + 9), j2a_get_u32(bytes + 11));
#endif
    if (code != 0)
        return code;
    put_status(bytes);
    *length = STATUS_BYTES;
    return 0;
}

#endif
