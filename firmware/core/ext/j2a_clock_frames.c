/* USB frames as a clock (LINKS.md, section 3). In: the starts of frames that the port saw, and times of frames that
 * the host told. Out: the line of the host's time over the local time, and which frame was the last one.
 * Two loops follow one another. The first one leads a phase and a period to the starts of frames by the local time;
 * what is late, because an interrupt had to wait, counts little. The second one leads a line over the number of the
 * frame to what the host tells, so that all boards on a bus that are told the same have the same line.
 * Rules: integers only; frames that were not seen count by their number. */
#include "j2a_clock.h"

#if J2A_WITH_SYNC && J2A_PORT_FRAMES

#define FRAME_US 1000
#define US (1UL << 22)             /* a phase and a period are in 2^-22 us, a phase modulo 1024 us */
#define PERIOD (FRAME_US * US)
#define MAX_OFF (PERIOD / 64)      /* no crystal is so wrong; beyond that no start would be found any more */
#define LIMIT ((int32_t)(100 * US)) /* a start so far from its phase is none of this row */
#define MAX_RATE (1L << 22)          /* of the host's time over frames: 1000 ppm, in 2^-32 */
#define MAX_GAP_US 1000000UL       /* longer without a look: the numbers do not tell how many frames it was */

/* The first loop takes 2^-phase of an error into the phase and 2^-period of it into the period, where a critically
 * damped one has 2 * phase + 2; it takes no more than a clamp of it. It starts fast and changes down after frames of
 * each gear, and back up if the errors are of the same sign and beyond the clamp all the time. */
enum { GEARS = 4, RUNAWAY = 64 };
static const uint8_t J2A_FLASH phase_bits[GEARS] = {2, 4, 6, 9};
static const uint8_t J2A_FLASH frames_of_gear[GEARS] = {16, 64, 255, 0};
static const uint8_t J2A_FLASH clamp_us[GEARS] = {100, 20, 5, 2};

static bool has_phase;
static uint8_t gear, in_gear;
static int8_t runaway;         /* errors beyond the clamp in a row, negative ones below 0 */
static uint32_t frame;         /* number of the last frame, counted on beyond 2047 */
static uint32_t began;         /* its start in 1/16 us of local time, as seen */
static uint32_t phase;         /* the same in 2^-22 us, modulo 2^32, as the loop has it */
static uint32_t period = PERIOD;

/* The second loop: `at` is 1000 * frame, so the rate is that of the host's time over an ideal frame clock. */
static j2a_line host;
static bool told;              /* there is such a line */
static uint32_t told_frame;    /* of the last time that the host told */
static uint32_t told_span;     /* frames over which the line remembers what was told */

/* The line through n times at equal distances with the least squares of errors: of the error of the last one it takes
 * 2 * (2n - 1) / n / (n + 1) into the phase, and 6 / n / (n + 1) over the distance into the rate. In 1/64, for n from 2
 * on; n is how many such distances the line remembers, so a longer one counts for more than many short ones before. */
enum { MEMORY = 8 };
static const uint8_t J2A_FLASH phase_gain[MEMORY - 1] = {64, 53, 45, 38, 34, 30, 27};
static const uint8_t J2A_FLASH rate_gain[MEMORY - 1] = {64, 32, 19, 13, 9, 7, 5};

/* ------------------------------------------------------------------------- starts of frames ------ */

static void lock(const j2a_frame *seen) {
    has_phase = true;
    told = false; /* the line is over frames that are not counted any more */
    gear = in_gear = 0;
    runaway = 0;
    frame = seen->number;
    began = seen->began;
    phase = began << 18;
}

static int32_t round_shift(int32_t value, uint8_t bits) {
    return (value + ((int32_t)1 << (bits - 1))) >> bits;
}

/* Takes the error of a phase. */
static void follow(int32_t error) {
    const uint8_t bits = j2a_flash_u8(&phase_bits[gear]);
    const int32_t clamp = (int32_t)(j2a_flash_u8(&clamp_us[gear]) * US);
    if (error > clamp) {
        error = clamp;
        runaway = (int8_t)(runaway < 0 ? 1 : runaway + 1);
    } else if (error < -clamp) {
        error = -clamp;
        runaway = (int8_t)(runaway > 0 ? -1 : runaway - 1);
    } else {
        runaway = 0;
    }
    phase += (uint32_t)round_shift(error, bits);
    period += (uint32_t)round_shift(error, (uint8_t)(2 * bits + 2));
    if (period > PERIOD + MAX_OFF)
        period = PERIOD + MAX_OFF;
    if (period < PERIOD - MAX_OFF)
        period = PERIOD - MAX_OFF;
    if (runaway >= RUNAWAY || runaway <= -RUNAWAY) {
        runaway = 0;
        in_gear = 0;
        if (gear != 0)
            gear--;
    } else if (gear != GEARS - 1 && ++in_gear == j2a_flash_u8(&frames_of_gear[gear])) {
        in_gear = 0;
        gear++;
    }
}

void j2a_frames_turn(void) {
    j2a_frame seen;
    uint16_t passed;
    uint32_t gap_us;
    int32_t error;

    if (!j2a_port_frame(&seen)) {
        has_phase = false;
        return;
    }
    if (!has_phase) {
        lock(&seen);
        return;
    }
    passed = (uint16_t)((seen.number - frame) & (J2A_CLOCK_FRAME_NUMBERS - 1));
    gap_us = (seen.began - began) >> 4;
    if (passed == 0 && gap_us < FRAME_US / 2)
        return;
    error = (int32_t)((seen.began << 18) - (phase + passed * period));
    /* 1/64 is more than the two clocks differ: it tells a number that does not fit. */
    if (gap_us > MAX_GAP_US || error > LIMIT || error < -LIMIT
        || gap_us + gap_us / 64 + FRAME_US / 2 < (uint32_t)passed * FRAME_US
        || gap_us > (uint32_t)passed * FRAME_US + gap_us / 64 + FRAME_US / 2) {
        lock(&seen);
        return;
    }
    frame += passed;
    began = seen.began;
    phase += passed * period;
    follow(error);
}

/* ------------------------------------------------------------------------- times of the host ------ */

void j2a_frames_forget(void) {
    told = false;
}

/* Leads the line to a time that the host told, which is `error` sixteenths of a microsecond from it, `frames` frames
 * after the one before. An error of 1/16 us in a frame is a rate of 268435.456, which is 274877907 / 1024. */
static J2A_NOINLINE void lead(int32_t error, uint32_t frames) {
    uint32_t left = told_span;
    uint8_t times = 0; /* beyond the second one */
    int64_t part, rate;

    for (; times != MEMORY - 2 && left >= frames; times++)
        left -= frames;
    /* Not the lesser of both: the product overflows where nothing was told for 6 days. */
    told_span = left < frames ? told_span + frames : MEMORY * frames;
    part = (int64_t)error * ((int32_t)j2a_flash_u8(&phase_gain[times]) << 22) + host.part;
    rate = ((int64_t)error * (int32_t)(274877907UL / frames) * j2a_flash_u8(&rate_gain[times]) >> 16) + host.rate;
    host.rate = (int32_t)(rate > MAX_RATE ? MAX_RATE : rate < -MAX_RATE ? -MAX_RATE : rate);
    host.part = (uint32_t)part;
    host.time_us += (uint64_t)(part >> 32);
}

/* Returns the latest frame that has begun and has that number modulo 1024; its start, and those of some before, may not
 * have been seen. */
static uint32_t latest_of(uint16_t number) {
    const uint32_t later = (number - frame) & (J2A_CLOCK_FRAME_NUMBERS / 2 - 1);
    const int32_t age_us = (int32_t)(((uint32_t)j2a_port_time_us() << 4) - began) >> 4;
    if ((int32_t)(later * FRAME_US) <= age_us + FRAME_US / 2)
        return frame + later;
    return frame - ((frame - number) & (J2A_CLOCK_FRAME_NUMBERS / 2 - 1));
}

J2A_NOINLINE bool j2a_frames_told(uint64_t time_us, uint16_t number) {
    const int32_t far_us = (int32_t)(J2A_CLOCK_FRAME_STEP_S * 1000000UL);
    int64_t error_us;
    uint32_t of;
    uint32_t frames;

    j2a_frames_turn();
    if (!has_phase)
        return false;
    of = latest_of(number);
    j2a_line_move(&host, (int32_t)(of * FRAME_US - host.at));
    error_us = (int64_t)(time_us - host.time_us);
    if (!told || error_us >= far_us || error_us <= -far_us) {
        host.time_us = time_us;
        host.part = 0;
        told = true;
        told_frame = of;
        told_span = 0;
        return true;
    }
    frames = of - told_frame;
    if (frames == 0 || frames > UINT32_MAX - J2A_CLOCK_FRAME_NUMBERS / 2) /* the same one again, or an older one */
        return true;
    told_frame = of;
    lead((int32_t)error_us * 16 - (int32_t)(host.part >> 28), frames);
    return true;
}

/* Returns by how much a frame is longer than 1000 us, in 2^-32: (off * 1024 + 500) / 1000. No division of 64 bits, because an
 * AVR's library makes it by jumps through pointers, of which no bound for the stack can be told. 0.024 * 2^32 is so near to
 * a whole number that the result is the same up to MAX_OFF. */
static int32_t as_rate(int32_t off) {
    uint32_t low;
    const int32_t more = j2a_product(off, 103079215, &low);
    return off + more + (low >= 0x80000000) + (off < 0);
}

/* T over L = (T over frames) * (frames over L); with p and q for how much a frame is longer than 1000 us by either,
 * (1 + p) / (1 + q) - 1 = (p - q) * (1 - q + q * q) is exact to 0.1 ppb for a q of 0.3 %. */
J2A_NOINLINE void j2a_frames_target(j2a_line *target, uint32_t now) {
    const int32_t q = as_rate((int32_t)period - (int32_t)PERIOD);
    const uint32_t seen_us = now - (uint32_t)((int32_t)((now << 4) - began) >> 4); /* the start may be after now */
    const int32_t ahead = (int32_t)(phase - (seen_us << 22)); /* of the start by the loop, in 2^-22 us */
    int32_t rate;
    uint32_t low;
    int64_t part;

    if (!has_phase || !told)
        return;
    j2a_line_move(&host, (int32_t)(frame * FRAME_US - host.at));
    rate = host.rate - q;
    rate += j2a_product(-rate, q, &low) + j2a_product(j2a_product(rate, q, &low), q, &low);
    part = (int64_t)host.part - (int64_t)ahead * 1024;
    target->at = seen_us;
    target->part = (uint32_t)part;
    target->time_us = host.time_us + (uint64_t)(part >> 32);
    target->rate = rate;
}

void j2a_frames_put(uint8_t *bytes, uint32_t local) {
    uint16_t number = J2A_CLOCK_NO_FRAME;
    uint32_t age_us = 0;
    j2a_frame seen;
    if (j2a_port_frame(&seen)) {
        const uint32_t now = (uint32_t)j2a_port_time_us();
        const uint32_t begin = now - (uint32_t)((int32_t)((now << 4) - seen.began) >> 4);
        const uint32_t later = (int32_t)(local - begin) < 0 ? (begin - local + FRAME_US - 1) / FRAME_US : 0;
        number = (uint16_t)((seen.number - later) & (J2A_CLOCK_FRAME_NUMBERS - 1));
        age_us = local - begin + later * FRAME_US; /* later: frames that began after the request had come */
    }
    j2a_put_u16(bytes, number);
    j2a_put_u16(bytes + 2, (uint16_t)(age_us < 0xFFFF ? age_us : 0xFFFF));
}

#endif
