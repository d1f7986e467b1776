/* A libFuzzer target: the whole core with transducers, against a second opinion (model.c).
 * In: events, one byte each and what they need: a value of a driver, a request on the link, whole or damaged, time that
 * passes, a turn of the main loop. Out: an abort where a reply, a sample SIF or a call of a driver is not the one that
 * is due: more than one SIF in a turn, none though one is due, one with a value of the time 0 or of a sensor that is
 * disabled, losses that are not told.
 * Options add events: with J2A_WITH_SYNC the clock of values is set, with J2A_WITH_SAVE the device starts anew.
 * Rules: the local time never goes back; each input begins with the state in which a device starts. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "j2a_internal.h"
#include "j2a_transds.h"
#include "model.h"
#include "transds.h"

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t count);
int LLVMFuzzerInitialize(int *argc, char ***argv);

#define CHECK(condition) \
    do { \
        if (!(condition)) { \
            fprintf(stderr, "turns.c:%d: not so: %s\n", __LINE__, #condition); \
            abort(); \
        } \
    } while (0)

/* ------------------------------------------------------------------------- the link ------ */

enum { OUTPUT = 2 * J2A_MAX_WIRE, CALLS = 64 };
static uint8_t input[J2A_MAX_WIRE], sent[OUTPUT];
static size_t input_next, input_end, sent_length;
static uint64_t now_us;
static uint8_t sif_seq;

void j2a_port_tx(uint8_t byte) {
    CHECK(sent_length < sizeof sent);
    sent[sent_length++] = byte;
}

int16_t j2a_port_rx(void) {
    return input_next == input_end ? -1 : (int16_t)input[input_next++];
}

uint16_t j2a_port_ticks(void) {
    return 0;
}

uint64_t j2a_port_time_us(void) {
    return now_us;
}

/* A stamp is the time with a bit that makes none of them 0. */
#if J2A_PORT_STAMP
void j2a_port_stamp(volatile uint8_t *stamp) {
    uint8_t i;
    for (i = 0; i < J2A_STAMP_BYTES; i++)
        stamp[i] = (uint8_t)((now_us | 1ULL << 63) >> 8 * i);
}

uint64_t j2a_port_stamp_us(const uint8_t *stamp) {
    return j2a_get_u64(stamp) & ~(1ULL << 63);
}
#endif

/* A clock that the host has set so far ahead, in place of ext/j2a_clock.c. */
static uint64_t ahead_us;

#if J2A_WITH_SYNC
uint64_t j2a_received_us;

uint64_t j2a_clock_us(void) {
    return now_us + ahead_us;
}

bool j2a_clock_is_due(uint64_t due_us) {
    return due_us <= j2a_clock_us();
}

void j2a_clock_turn(void) {
}

uint8_t j2a_clock(uint8_t *const length, uint8_t **const payload) {
    (void)payload;
    *length = 0;
    return J2A_RET_FAILED;
}
#endif

/* What stays without power. */
#if J2A_WITH_SAVE
static uint8_t kept[J2A_PORT_KEPT_BYTES];

uint8_t j2a_port_kept(uint16_t at) {
    CHECK(at < sizeof kept);
    return kept[at];
}

bool j2a_port_keep(uint16_t at, uint8_t byte) {
    CHECK(at < sizeof kept);
    kept[at] = byte;
    return true;
}
#endif

static void put(uint8_t byte) {
    if (byte == J2A_SOF || byte == J2A_SOS || byte == J2A_ESC) {
        input[input_end++] = J2A_ESC;
        byte--;
    }
    input[input_end++] = byte;
}

/* The one frame that was sent, without stuffing. */
static uint8_t body[4 + J2A_MAX_PAYLOAD];
static size_t body_length;

static void unstuff(void) {
    size_t at;
    body_length = 0;
    for (at = 1; at < sent_length; at++) {
        CHECK(sent[at] != J2A_SOF && sent[at] != J2A_SOS && body_length < sizeof body);
        body[body_length++] = sent[at] == J2A_ESC ? (uint8_t)(sent[++at] + 1) : sent[at];
    }
}

/* Checks that this frame was sent and nothing else. */
static void take_frame(uint8_t start, uint8_t seq, uint8_t opcode, const uint8_t *payload, uint8_t length) {
    unstuff();
    CHECK(sent_length > 0 && sent[0] == start);
    CHECK(body_length == 4u + length);
    CHECK(body[0] == seq && body[1] == opcode && body[2] == length);
    CHECK(memcmp(body + 3, payload, length) == 0);
    sent_length = 0;
}

/* ------------------------------------------------------------------------- drivers ------ */

static model_call called[CALLS], wanted[CALLS];
static size_t called_count, wanted_count;

void model_calls(const model_call *call) {
    CHECK(wanted_count < CALLS);
    wanted[wanted_count++] = *call;
}

static void note(uint8_t index, bool is_start, uint8_t channel, const void *value, size_t size) {
    model_call call = {.index = index, .channel = channel, .is_start = is_start};
    CHECK(called_count < CALLS);
    memcpy(call.value, value, size);
    called[called_count++] = call;
}

static void compare_calls(void) {
    size_t i;
    CHECK(called_count == wanted_count);
    for (i = 0; i < called_count; i++) {
        CHECK(called[i].index == wanted[i].index && called[i].channel == wanted[i].channel);
        CHECK(called[i].is_start == wanted[i].is_start);
        CHECK(memcmp(called[i].value, wanted[i].value, MOST_SIZE) == 0);
    }
    called_count = wanted_count = 0;
}

#define SENSOR_DRIVER(prefix, type) \
    static void (*prefix##_cb) J2A_VALUE_OF(type); \
    void prefix##_set_cb(void (*callback) J2A_VALUE_OF(type)) { \
        prefix##_cb = callback; \
    }
SENSOR_DRIVER(plain, i16)
SENSOR_DRIVER(queued, u16)
SENSOR_DRIVER(tuned, i32)
SENSOR_DRIVER(huge, u64)
SENSOR_DRIVER(level, f32)
SENSOR_DRIVER(exact, f64)
SENSOR_DRIVER(imu, motion)
SENSOR_DRIVER(bell, i8)
SENSOR_DRIVER(deep, u8)

static void sense(uint8_t index, uint8_t channel, const uint8_t *value) {
    motion whole;
    model_sense(index, channel, value, now_us);
    switch (index) {
    case 0: plain_cb(channel, j2a_get_i16(value)); break;
    case 1: queued_cb(channel, j2a_get_u16(value)); break;
    case 2: tuned_cb(channel, j2a_get_i32(value)); break;
    case 3: huge_cb(channel, j2a_get_u64(value)); break;
    case 4: level_cb(channel, j2a_get_f32(value)); break;
    case 5: exact_cb(channel, j2a_get_f64(value)); break;
    case 6:
        j2a_take_motion(&whole, value);
        imu_cb(channel, &whole);
        break;
    case 7: bell_cb(channel, (int8_t)value[0]); break;
    default: deep_cb(channel, value[0]);
    }
}

/* A driver that measures at once, and one that does so later. */
void bell_trigger(void) {
    note(7, true, 0, "", 0);
}

void imu_trigger(void) {
    note(6, true, 0, "", 0);
}

void servo_set(uint8_t channel, int8_t value) {
    note(9, false, channel, &value, sizeof value);
}

void motor_set(uint8_t channel, float value) {
    note(10, false, channel, &value, sizeof value);
}

void pose_set(uint8_t channel, const motion *value) {
    uint8_t bytes[J2A_MAX_PAYLOAD];
    j2a_put_motion(bytes, value);
    note(11, false, channel, bytes, 12);
}

void lights_set(uint8_t channel, uint16_t value) {
    note(12, false, channel, &value, sizeof value);
}

/* ------------------------------------------------------------------------- the state ------ */

/* What the core keeps of each transducer, as it was when the program began: in the order of keep(). */
static uint8_t first[16384];

static size_t keep(void *part, size_t size, size_t at, bool is_back) {
    if (!part)
        return at;
    CHECK(at + size <= sizeof first);
    if (is_back)
        memcpy(part, first + at, size);
    else
        memcpy(first + at, part, size);
    return at + size;
}

static void keep_all(bool is_back) {
    size_t at = 0;
    uint8_t i;
    for (i = 0; i < j2a_transducer_count; i++) {
        const j2a_transducer *const t = &j2a_transducers[i];
        const size_t channels = t->channels, size = t->size;
        const size_t slots = t->depth ? t->depth * (9 + size) : channels * (8 + size);
        at = keep(t->sensor, sizeof *t->sensor, at, is_back);
        at = keep(t->queue, sizeof *t->queue, at, is_back);
        at = keep((void *)(uintptr_t)t->slots, slots, at, is_back);
        at = keep(t->decimation, 1 + channels, at, is_back);
        at = keep(t->threshold, 1 + 2 * size, at, is_back);
        at = keep(t->last, channels * (1 + size), at, is_back);
        at = keep(t->topic, J2A_TRANSD_MAX_TOPIC + 1, at, is_back);
        at = keep(t->trigger, sizeof *t->trigger, at, is_back);
        at = keep(t->waiting, channels * sizeof *t->waiting, at, is_back);
        at = keep(t->values, channels * size, at, is_back);
        at = keep(t->watchdog, sizeof *t->watchdog, at, is_back);
    }
}

static uint8_t transd; /* the opcode of a2jTransd */

int LLVMFuzzerInitialize(int *argc, char ***argv) {
    j2a_function function;
    (void)argc;
    (void)argv;
    CHECK(j2a_transducer_count == TRANSDUCERS);
    transds_init();
    keep_all(false);
    while (j2a_find(transd, J2A_KIND_CALL, &function) != 0 || function != (j2a_function)j2a_transd)
        transd++;
    return 0;
}

/* ------------------------------------------------------------------------- events ------ */

static unsigned overtaken[TRANSDUCERS]; /* times that another sensor was sent, though this one was due */

static void turn(void) {
    uint8_t payload[MOST_BYTES], length, found[MOST_BYTES], found_length = 0;
    uint8_t which = TRANSDUCERS;
    uint8_t i;
    transds_process();
    model_turn(now_us);
    compare_calls();
    unstuff();
    for (i = 0; i < TRANSDUCERS; i++) {
        if (!model_is_due(i, now_us, payload, &length)) {
            overtaken[i] = 0;
        } else if (body_length > 1 && body[1] == model_of[i].id) {
            which = i;
            found_length = length;
            memcpy(found, payload, length);
            overtaken[i] = 0;
        } else {
            CHECK(body_length > 0 && ++overtaken[i] < TRANSDUCERS);
        }
    }
    if (which == TRANSDUCERS) {
        CHECK(sent_length == 0);
        return;
    }
    take_frame(J2A_SOS, sif_seq++, model_of[which].id, found, found_length);
    model_sent(which, now_us);
}

/* Sends a request, of which a bit of one byte is wrong if `damaged` is not 0. */
static void request(const uint8_t *payload, uint8_t length, uint8_t seq, uint8_t damaged) {
    uint8_t reply[J2A_MAX_PAYLOAD];
    uint8_t sum = (uint8_t)(seq ^ (transd + J2A_CHK_OPCODE) ^ (length + J2A_CHK_LENGTH));
    uint8_t code, i;
    const uint8_t wrong_at = length ? damaged % length : 0;
    input_next = input_end = 0;
    input[input_end++] = J2A_SOF;
    put(seq);
    put(transd);
    put(length);
    for (i = 0; i < length; i++) {
        sum ^= payload[i];
        put((uint8_t)(payload[i] ^ (i == wrong_at ? damaged : 0)));
    }
    put(length ? sum : sum ^ damaged);
    while (input_next < input_end)
        j2a_poll();
    j2a_process();
    if (damaged) {
        const uint8_t site[] = {J2A_SITE_CHECKSUM, 0};
        take_frame(J2A_SOF, seq, J2A_ERR_CHECKSUM, site, 2);
        return;
    }
    model_hear(now_us);
    code = model_request(payload, length, reply, &length, now_us);
    take_frame(J2A_SOF, seq, code, reply, length);
    compare_calls();
}

static uint8_t take(const uint8_t **bytes, const uint8_t *end) {
    return *bytes == end ? 0 : *(*bytes)++;
}

/* Values of interest to limits: the ends of types, not-numbers, what is near the value before. */
static void value_of(uint8_t how, uint8_t *value, const uint8_t **bytes, const uint8_t *end) {
    static uint8_t last[MOST_SIZE];
    uint8_t i;
    for (i = 0; i < MOST_SIZE; i++)
        value[i] = how % 8 == 0 ? take(bytes, end) : how % 8 == 1 ? 0xFF : how % 8 == 2 ? 0 : last[i];
    if (how % 8 == 3)
        value[0]++;
    if (how % 8 == 4)
        value[0]--;
    if (how % 8 == 5)
        value[how / 8 % MOST_SIZE] ^= 0x80;
    memcpy(last, value, sizeof last);
}

static void some_request(uint8_t how, const uint8_t **bytes, const uint8_t *end) {
    static const uint8_t sizes[] = {0, 1, 4, 1, 4, 3, 2, 0, 8, J2A_WITH_SAVE, 0};
    uint8_t payload[J2A_MAX_PAYLOAD] = {0};
    const described *const d = &model_of[take(bytes, end) % TRANSDUCERS];
    const uint8_t item = take(bytes, end);
    uint8_t length = 2;
    uint8_t i;
    payload[0] = how & 1 ? take(bytes, end) : d->id;
    payload[1] = how & 1 ? item : item % 11;
    if (how & 2) { /* any length */
        length = take(bytes, end);
    } else if (how & 4) {
        length = 2;
        if (payload[1] < sizeof sizes)
            length = (uint8_t)(2 + (payload[1] == J2A_TRANSD_THRESHOLD ? d->size : sizes[payload[1]]));
        if (payload[1] == J2A_TRANSD_SET)
            length = (uint8_t)(2 + 9 + d->size * (1 + take(bytes, end) % MOST_CHANNELS));
    }
    for (i = 2; i < length; i++)
        payload[i] = take(bytes, end);
    if ((how & 8) && length >= 11) { /* a time that is near; the first channel */
        const uint64_t due_us = now_us + payload[3] * 100u - 1000;
        const uint8_t at = payload[1] == J2A_TRANSD_SET ? 3 : 2;
        for (i = 0; i < 8 && at + i < length; i++)
            payload[at + i] = (uint8_t)(due_us >> 8 * i);
        if (payload[1] == J2A_TRANSD_SET)
            payload[2] %= d->channels;
    }
    if ((how & 8) && J2A_WITH_SAVE && payload[1] == J2A_TRANSD_SAVE && length == 3)
        payload[2] = J2A_TRANSD_SAVED;
    request(payload, length, how, how & 0x80 && how & 0x40 ? how : 0);
}

/* The host sets the clock: to the local time, or so far ahead of it. */
static void set_clock(uint8_t how) {
#if J2A_WITH_SYNC
    const uint64_t to_us = how % 61 ? 1ULL << how % 61 : 0;
    j2a_transds_move(to_us - ahead_us);
    model_clock(ahead_us = to_us);
#else
    (void)how;
#endif
}

static void restart(void) {
#if J2A_WITH_SAVE
    turn(); /* what is being kept is whole then */
    keep_all(true);
    ahead_us = 0;
    transds_init();
    j2a_is_heard = true;
    model_restart(now_us);
#endif
}

/* Around the period and the watchdog of transds.def. */
static const uint16_t edges[] = {999, 1000, 1001, 2999, 3000, 4000};

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t count) {
    const uint8_t *const end = bytes + count;
    uint8_t begin;
    memset(j2a_served(), 0, sizeof(j2a_rx_t));
    memset(overtaken, 0, sizeof overtaken);
    keep_all(true);
    model_reset();
    sif_seq = 0;
    begin = take(&bytes, end);
    now_us = begin < 128 ? begin % 4 : 1ULL << begin % 56; /* 0 is no time of a value */
#if J2A_WITH_SYNC
    now_us += now_us == 0; /* no local time at which a SIF was sent either, and a device has no turn that early */
#endif
    ahead_us = 0;
#if J2A_WITH_SAVE
    memset(kept, 0xFF, sizeof kept);
#endif
    j2a_is_heard = true;
    model_hear(now_us);
    turn();
    while (bytes < end) {
        const uint8_t event = *bytes++;
        const uint8_t how = take(&bytes, end);
        uint8_t value[MOST_SIZE], again;
        switch (event % 6) {
        case 0: /* a driver gives a value, perhaps many times */
        case 1:
            value_of(event / 6, value, &bytes, end);
            for (again = event % 6 ? 0 : how >> 5; again < 8; again++)
                sense(how % 9, (uint8_t)(how / 9 % 8), value);
            break;
        case 2:
            some_request(how, &bytes, end);
            break;
        case 3: /* up to 65 ms, or to an edge */
            now_us += event / 6 % 10 < 9 ? (uint64_t)how << event / 6 % 10 : edges[how % 6];
            turn();
            break;
        case 4: /* up to 25 days: the main loop turns that often, so 32 bits of milliseconds do not wrap unseen */
            if (now_us < 1ULL << 60)
                now_us += how % 43 < 42 ? 1ULL << how % 43 : 2147483648000ULL;
            turn();
            break;
        default:
            if (how % 4 == 1)
                set_clock(how / 4);
            if (how % 4 == 2)
                restart();
            turn();
        }
    }
    turn();
    return 0;
}
