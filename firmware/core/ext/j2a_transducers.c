/* Transducers: values of drivers flow in by j2a_sense(), settings by a2jTransd; out flow sample SIFs, values for
 * actuators, and descriptors (SPEC.md, section 22).
 * Rules: j2a_sense() and j2a_keep() may run in an interrupt, all else in the main context, and neither waits for the other. Each
 * byte that both use is written by one of them: without a queue the main context copies a channel anew when a value
 * came in between, with one each context has its own counter. */
#include "j2a_transds.h"

#if J2A_WITH_TRANSDUCERS

#if !J2A_WITH_CLOCK
#error "J2A_WITH_TRANSDUCERS=1 needs J2A_WITH_CLOCK=1, the time of values"
#endif

/* Copies of a channel until one has met no value in between; then the next turn tries again. */
enum { COPIES = 16 };

/* The server sets it with each request, the watchdogs take it. */
bool j2a_is_heard;

static uint32_t heard_ms;
static uint8_t next; /* the transducer whose turn it is to be sent */
static bool has_orders; /* SET or TRIGGER may wait for its time */

/* While transducers are served or changed a port that waits keeps away from them; where it did not, watchdogs have looked at
 * a later time than the turn began at. */
enum { FREE, BUSY, LOOKED };
static uint8_t service;

static void load(j2a_transducer *to, uint8_t index) {
    j2a_flash_load(to, &j2a_transducers[index], sizeof *to);
}

/* The clock of values, SET and TRIGGER; intervals are measured in local time (J2A-CLOCK-019). */
#if J2A_WITH_SYNC
#define clock_us j2a_clock_us
#define local_us j2a_port_time_us
#define is_due j2a_clock_is_due
#else
#define clock_us j2a_port_time_us
#define local_us now_us
#define is_due(due_us) ((due_us) <= clock_us())
#endif

static uint64_t now_us(void) {
    const uint64_t time_us = clock_us();
    return time_us != 0 ? time_us : 1; /* 0 says that there is no value */
}

/* ------------------------------------------------------------------------- values ------ */

/* flip: 0x80 for numbers with a sign, which turns their order into that of numbers without one. */
static int8_t compare(const uint8_t *a, const uint8_t *b, uint8_t size, uint8_t flip) {
    while (size-- != 0) {
        const uint8_t of_a = a[size] ^ flip;
        const uint8_t of_b = b[size] ^ flip;
        flip = 0;
        if (of_a != of_b)
            return of_a < of_b ? -1 : 1;
    }
    return 0;
}

/* The difference of two numbers of n bytes fits into n bytes without a sign. */
static bool is_near(const uint8_t *a, const uint8_t *b, const uint8_t *limit, uint8_t size, uint8_t flip) {
    const bool is_less = compare(a, b, size, flip) < 0;
    const uint8_t *const high = is_less ? b : a;
    const uint8_t *const low = is_less ? a : b;
    uint8_t borrow = 0;
    bool is_below = false;
    uint8_t i;
    for (i = 0; i < size; i++) {
        const uint16_t taken = (uint16_t)(low[i] + borrow);
        const uint8_t digit = (uint8_t)(high[i] - taken);
        borrow = taken > high[i];
        if (digit != limit[i])
            is_below = digit < limit[i];
    }
    return is_below;
}

int8_t j2a_compare_unsigned(const uint8_t *a, const uint8_t *b, uint8_t size) {
    return compare(a, b, size, 0);
}

int8_t j2a_compare_signed(const uint8_t *a, const uint8_t *b, uint8_t size) {
    return compare(a, b, size, 0x80);
}

bool j2a_near_unsigned(const uint8_t *a, const uint8_t *b, const uint8_t *limit, uint8_t size) {
    return is_near(a, b, limit, size, 0);
}

bool j2a_near_signed(const uint8_t *a, const uint8_t *b, const uint8_t *limit, uint8_t size) {
    return is_near(a, b, limit, size, 0x80);
}

/* A number and none differ by more than any limit. A variable rounds a difference to its type where registers hold more
 * digits (J2A-TRANS-013). */
#define FLOATING(name, type) \
    int8_t j2a_compare_##name(const uint8_t *a, const uint8_t *b, uint8_t size) { \
        const type of_a = j2a_get_##name(a); \
        const type of_b = j2a_get_##name(b); \
        (void)size; \
        return of_a < of_b ? -1 : of_a > of_b ? 1 : of_a == of_b ? 0 : 2; \
    } \
    bool j2a_near_##name(const uint8_t *a, const uint8_t *b, const uint8_t *limit, uint8_t size) { \
        const type of_a = j2a_get_##name(a); \
        const type of_b = j2a_get_##name(b); \
        const type least = j2a_get_##name(limit); \
        type apart; \
        (void)size; \
        if (of_a != of_a || of_b != of_b) \
            return of_a != of_a && of_b != of_b && least > 0; \
        if (of_a == of_b) \
            return least > 0; \
        apart = of_a > of_b ? of_a - of_b : of_b - of_a; \
        return apart < least; \
    }
FLOATING(f32, float)
#if DBL_MANT_DIG == 53
FLOATING(f64, double)
#endif

/* ------------------------------------------------------------------------- sensors: what comes from drivers ------ */

static bool is_na(const j2a_transducer *t, const uint8_t *value) {
    uint8_t na[8];
    return t->raw && t->raw(J2A_RAW_NA, na) && t->compare(value, na, t->size) == 0;
}

/* Whether a sensor with threshold takes a value, of which `last` is the one taken before, null if there is none. */
static bool is_far(const j2a_transducer *t, const uint8_t *value, const volatile uint8_t *last) {
    uint8_t before[8];
    uint8_t i;
    if (!last)
        return true;
    for (i = 0; i < t->size; i++)
        before[i] = last[i];
    return is_na(t, value) != is_na(t, before) ||
           !t->is_near(value, before, t->threshold + 1 + (t->threshold[0] != 0 ? t->size : 0), t->size);
}

/* Copies bytes, because a driver's interrupt calls it, and small chips shift 64 bits one by one. */
static volatile uint8_t *write_time(volatile uint8_t *to, uint64_t time_us) {
    const uint16_t one = 1;
    const bool is_little = *(const uint8_t *)&one != 0;
    const uint8_t *const from = (const uint8_t *)&time_us;
    uint8_t i;
    for (i = 0; i < J2A_TIME_BYTES; i++)
        to[i] = from[is_little ? i : J2A_TIME_BYTES - 1 - i];
    return to + J2A_TIME_BYTES;
}

static void write_value(volatile uint8_t *to, const uint8_t *value, uint8_t size) {
    uint8_t i;
    for (i = 0; i < size; i++)
        to[i] = value[i];
}

static bool has_time(const volatile uint8_t *slot) {
    uint8_t i = 0;
    while (i < J2A_TIME_BYTES && slot[i] == 0)
        i++;
    return i < J2A_TIME_BYTES;
}

static bool is_chosen(const j2a_transducer *t, uint8_t channel) {
    if (!t->decimation)
        return true;
    if (++t->decimation[1 + channel] < t->decimation[0])
        return false;
    t->decimation[1 + channel] = 0;
    return true;
}

/* What j2a_stamp() wrote becomes microseconds. */
#if J2A_PORT_STAMP && !J2A_WITH_SYNC
static void convert_stamp(uint8_t *time) {
    uint64_t time_us;
    if (!has_time(time))
        return;
    time_us = j2a_port_stamp_us(time);
    (void)write_time(time, time_us != 0 ? time_us : 1);
}
#else
void j2a_stamp(volatile uint8_t *to) {
    (void)write_time(to, now_us());
}

static void convert_stamp(uint8_t *time) {
    (void)time;
}
#endif

void j2a_sense(uint8_t index, uint8_t channel, const uint8_t *value) {
    uint8_t stamp[J2A_TIME_BYTES];
    j2a_transducer t;
    j2a_sensor *sensor;
    j2a_queue *queue;
    volatile uint8_t *slot;

    j2a_stamp(stamp); /* before anything that takes its time */
    j2a_flash_load(&t, &j2a_transducers[index], offsetof(j2a_transducer, topic));
    sensor = t.sensor;
    queue = t.queue;
    if (channel >= t.channels || !is_chosen(&t, channel))
        return;
    if (t.threshold)
        load(&t, index);
    if (t.depth == 0) {
        slot = t.slots + channel * (J2A_TIME_BYTES + t.size);
        if (t.threshold && !is_far(&t, value, has_time(slot) ? slot + J2A_TIME_BYTES : 0))
            return;
        sensor->head++;
        write_value(slot, stamp, J2A_TIME_BYTES);
        write_value(slot + J2A_TIME_BYTES, value, t.size);
        sensor->head++;
        sensor->is_fresh = true;
        return;
    }
    if (!sensor->is_enabled)
        return;
    if (t.last) {
        uint8_t *const last = t.last + channel * (1 + t.size);
        if (!is_far(&t, value, last[0] != 0 ? last + 1 : 0))
            return;
        last[0] = 1;
        write_value(last + 1, value, t.size);
    }
    if ((uint8_t)(sensor->head - queue->tail) >= t.depth) {
        queue->full++;
        return;
    }
    slot = t.slots + queue->put_at * (1 + J2A_TIME_BYTES + t.size);
    *slot = channel;
    write_value(slot + 1, stamp, J2A_TIME_BYTES);
    write_value(slot + 1 + J2A_TIME_BYTES, value, t.size);
    queue->put_at = (uint8_t)(queue->put_at + 1 == t.depth ? 0 : queue->put_at + 1);
    sensor->head++;
}

/* ------------------------------------------------------------------------- sensors: what goes to the host ------ */

/* Copies a sample; returns its bytes, 0 if values came in between all the time. */
static uint8_t copy_sample(const j2a_transducer *t, uint8_t *payload) {
    const uint8_t size = (uint8_t)(J2A_TIME_BYTES + t->size);
    const volatile uint8_t *slot = t->slots;
    uint8_t length = 0;
    uint8_t channel;
    for (channel = 0; channel < t->channels; channel++, slot += size, length = (uint8_t)(length + size)) {
        uint8_t copies = COPIES;
        uint8_t version;
        uint8_t i;
        do {
            if (copies-- == 0)
                return 0;
            version = t->sensor ? t->sensor->head : 0;
            for (i = 0; i < size; i++)
                payload[length + i] = slot[i];
        } while (t->sensor && ((version & 1) != 0 || version != t->sensor->head));
        if (t->sensor)
            convert_stamp(payload + length);
    }
    return length;
}

/* A counter of two bytes that a driver may count at the same time. */
static uint16_t count_of(const volatile uint16_t *counter) {
    uint8_t copies = COPIES;
    uint16_t count = *counter;
    while (copies-- != 0 && count != *counter)
        count = *counter;
    return count;
}

/* Moves values of a queue into a sample SIF; returns its bytes, 0 without values. */
static uint8_t move_queued(const j2a_transducer *t, uint8_t *payload) {
    const uint8_t size = (uint8_t)(1 + J2A_TIME_BYTES + t->size);
    const uint8_t most = (uint8_t)((J2A_SAMPLE_ROOM - J2A_LOST_BYTES) / size);
    const j2a_sensor *const sensor = t->sensor;
    j2a_queue *const queue = t->queue;
    uint8_t left = (uint8_t)(sensor->head - queue->tail);
    uint8_t length = J2A_LOST_BYTES;
    if (left == 0)
        return 0;
    j2a_put_u16(payload, (uint16_t)(count_of(&queue->full) + queue->dropped));
    if (left > t->depth)
        left = t->depth; /* never more, but it takes no memory of earlier calls to see it here */
    for (left = left < most ? left : most; left != 0; left--) {
        const volatile uint8_t *const slot = t->slots + queue->take_at * size;
        uint8_t i;
        for (i = 0; i < size; i++)
            payload[length + i] = slot[i];
        convert_stamp(payload + length + 1);
        length = (uint8_t)(length + size);
        queue->take_at = (uint8_t)(queue->take_at + 1 == t->depth ? 0 : queue->take_at + 1);
        queue->tail++;
    }
    return length;
}

/* A sample SIF begins so long after it was due (J2A-TRANS-011); on AVRs inside report() it takes much more flash. */
static J2A_NOINLINE void move_reference(j2a_sensor *sensor, uint64_t late_us) {
    if (late_us < sensor->period_us)
        late_us = 0; /* does not add up */
    sensor->reference_us += late_us + sensor->period_us;
}

/* Sends a sample SIF of a sensor, if it is due; returns whether it was. */
static bool report(const j2a_transducer *t, uint8_t *payload) {
    j2a_sensor *const sensor = t->sensor;
    uint64_t late_us;
    uint8_t length;
    if (t->depth == 0 ? !sensor->is_fresh : sensor->head == t->queue->tail)
        return false; /* the usual case, before the time, which small chips calculate slowly */
    late_us = local_us() - sensor->reference_us - sensor->period_us;
    if (!sensor->is_enabled || late_us >> 63 != 0) /* it is due later */
        return false;
    if (t->depth != 0) {
        length = move_queued(t, payload);
    } else {
        sensor->is_fresh = false;
        length = copy_sample(t, payload);
        if (length == 0)
            sensor->is_fresh = true;
    }
    if (length == 0)
        return false;
    move_reference(sensor, late_us);
    service = FREE;
    j2a_send_sif(t->id, length, payload);
    return true;
}

/* ------------------------------------------------------------------------- actuators ------ */

static void set(const j2a_transducer *t, uint8_t channel, const uint8_t *value) {
    volatile uint8_t *const slot = t->slots + channel * (J2A_TIME_BYTES + t->size);
    t->set(channel, value);
    write_value(write_time(slot, now_us()), value, t->size);
}

/* Returns whether it set a channel. */
static bool set_due(const j2a_transducer *t) {
    bool has_set = false;
    uint8_t channel;
    for (channel = 0; channel < t->channels; channel++) {
        j2a_due *const waiting = &t->waiting[channel];
        if (waiting->waits && is_due(waiting->due_us)) {
            waiting->waits = false;
            set(t, channel, t->values + channel * t->size);
            has_set = true;
        }
        if (waiting->waits)
            has_orders = true;
    }
    return has_set;
}

static void set_safe(const j2a_transducer *t) {
    uint8_t channel;
    for (channel = 0; channel < t->channels; channel++) {
        uint8_t *const value = t->values + channel * t->size; /* nothing waits for it any more */
        uint8_t i;
        t->waiting[channel].waits = false;
        for (i = 0; i < t->size; i++)
            value[i] = 0;
        if (t->raw)
            (void)t->raw(J2A_RAW_NA, value);
        set(t, channel, value);
    }
}

static void watch(const j2a_transducer *t, uint32_t now_ms) {
    uint32_t silence_ms = now_ms - heard_ms;
    if (silence_ms > UINT16_MAX + 1UL) { /* no watchdog has a longer limit, and 32 bits wrap */
        silence_ms = UINT16_MAX + 1UL;
        heard_ms = now_ms - silence_ms;
    }
    /* The first of these milliseconds may have been over nearly. */
    if (t->watchdog->limit_ms == 0 || silence_ms <= t->watchdog->limit_ms)
        t->watchdog->is_safe = false;
    else if (!t->watchdog->is_safe) {
        t->watchdog->is_safe = true;
        set_safe(t);
    }
}

#if J2A_WITH_SYNC
static J2A_NOINLINE void move_due(j2a_due *due, uint64_t by_us) {
    const uint64_t sum_us = due->due_us + by_us;
    const bool is_back = by_us >> 63 != 0;
    due->due_us = (sum_us > due->due_us) != is_back || by_us == 0 ? sum_us : is_back ? 0 : UINT64_MAX;
}

J2A_NOINLINE void j2a_transds_move(uint64_t by_us) {
    j2a_transducer t;
    uint8_t index;
    uint8_t channel;
    for (index = 0; index < j2a_transducer_count; index++) {
        load(&t, index);
        if (t.trigger)
            move_due(t.trigger, by_us);
        for (channel = 0; t.waiting && channel < t.channels; channel++)
            move_due(&t.waiting[channel], by_us);
    }
}
#endif

/* Whether the values of SET are such that none is out of range. */
static bool are_in_range(const j2a_transducer *t, const uint8_t *values, uint8_t count) {
    uint8_t low[8];
    uint8_t high[8];
    if (!t->raw || !t->raw(J2A_RAW_LOW, low) || !t->raw(J2A_RAW_HIGH, high))
        return true;
    for (; count != 0; count--, values += t->size) {
        const int8_t above = t->compare(values, high, t->size);
        if (above > 0 || t->compare(values, low, t->size) < 0)
            return false;
    }
    return true;
}

/* Whether an order has not had its turn yet though its time has come: it waits no more, so another one does not replace it. */
static J2A_NOINLINE bool is_late(const j2a_due *order) {
    return order->waits && order->due_us <= clock_us();
}

static uint8_t set_channels(const j2a_transducer *t, const uint8_t *bytes, uint8_t length) {
    const uint8_t first = bytes[0];
    const uint8_t *value = bytes + 1 + J2A_TIME_BYTES;
    uint64_t due_us;
    uint8_t count;
    if (length <= 1 + J2A_TIME_BYTES || (length - 1 - J2A_TIME_BYTES) % t->size != 0)
        return J2A_TRANSD_BAD_LENGTH;
    count = (uint8_t)((length - 1 - J2A_TIME_BYTES) / t->size);
    if (first >= t->channels || count > t->channels - first || !are_in_range(t, value, count))
        return J2A_TRANSD_BAD_VALUE;
    due_us = j2a_get_u64(bytes + 1);
    has_orders = true;
    for (; count != 0; count--, value += t->size) {
        const uint8_t channel = (uint8_t)(first + (length - 1 - J2A_TIME_BYTES) / t->size - count);
        j2a_due *const waiting = &t->waiting[channel];
        if (is_late(waiting))
            set(t, channel, t->values + channel * t->size);
        waiting->waits = due_us > clock_us();
        waiting->due_us = due_us;
        if (waiting->waits)
            write_value(t->values + channel * t->size, value, t->size);
        else
            set(t, channel, value);
    }
    return 0;
}

/* ------------------------------------------------------------------------- the main loop ------ */

/* Notices that the host was heard; returns the time by which watchdogs watch. */
static uint32_t look(void) {
    const uint32_t now_ms = (uint32_t)(j2a_port_time_us() / 1000);
    if (j2a_is_heard) {
        j2a_is_heard = false;
        heard_ms = now_ms;
    }
    return now_ms;
}

/* Does what is due of a transducer, but sends nothing. Returns whether an order was. Inline, because turns are frequent, and
 * few ports wait. */
J2A_ALWAYS_INLINE bool act(const j2a_transducer *t, uint32_t now_ms) {
    bool has_acted = false;
    if (t->trigger && t->trigger->waits) {
        if (is_due(t->trigger->due_us)) {
            t->trigger->waits = false;
            t->start();
            has_acted = true;
        } else {
            has_orders = true;
        }
    }
    if (t->watchdog)
        watch(t, now_ms);
    if (t->waiting && set_due(t))
        has_acted = true;
    return has_acted;
}

void j2a_waiting(void) {
    j2a_transducer t;
    uint32_t now_ms;
    uint8_t index;
    if (service == BUSY)
        return;
    service = BUSY;
    now_ms = look();
    for (index = 0; index < j2a_transducer_count; index++) {
        load(&t, index);
        (void)act(&t, now_ms);
    }
    service = LOOKED;
}

void j2a_turn(uint8_t *payload) {
    uint32_t now_ms;
    bool has_sent = !payload;
    /* Orders go before a sample SIF, which takes the link its time: so many more transducers are looked at for them. Each
     * one that is due begins another round, because others of the same time were perhaps not due yet. */
    uint8_t ordering = has_orders ? j2a_transducer_count : 0;
    j2a_transducer t;
    uint8_t index;
    uint8_t left;

#if J2A_WITH_BOOT
    if (!j2a_greet())
        has_sent = true; /* nothing is taken out of a queue before the link is up */
#endif
    service = BUSY;
    has_orders = false;
    now_ms = look();
#if J2A_WITH_SAVE
    j2a_save_turn();
#endif
    /* Once around, from the transducer whose turn it is. */
    index = next;
    left = j2a_transducer_count;
    while (left != 0) {
        if (index >= j2a_transducer_count)
            index = 0;
        load(&t, index++);
        if (act(&t, now_ms))
            ordering = j2a_transducer_count;
        if (ordering != 0) {
            ordering--;
            continue;
        }
        left--;
        if (!has_sent && t.sensor && report(&t, payload)) {
            has_sent = true;
            next = index;
            if (service == LOOKED)
                now_ms = look();
            service = BUSY;
        }
    }
    service = FREE;
}

/* ------------------------------------------------------------------------- functions of the host ------ */

uint8_t j2a_get_transds(bool *is_last, bool is_write, uint32_t *const offset, uint8_t *const length,
                        uint8_t **const data) {
    uint32_t at;
    uint8_t n = 0;
    uint8_t c = 1;

    *length = 0;
    if (is_write)
        return J2A_RET_FAILED;
    *is_last = true;
    for (at = 0; (c = j2a_flash_u8(&j2a_descriptors[at])) != 0; at++) {
        if (at < *offset)
            continue;
        if (n == J2A_ROOM_MANY) {
            *is_last = false;
            break;
        }
        (*data)[n++] = c;
    }
    *length = n;
    return 0;
}

/* Whether a number is below 0, or none. */
static bool is_below_zero(const j2a_transducer *t, const uint8_t *value) {
    const uint8_t zero[8] = {0};
    const int8_t order = t->compare(value, zero, t->size);
    return order < 0 || order == 2;
}

/* The bytes behind the first one of a character of UTF-8, and the bits that the second one must not or may have. */
static bool is_text(const uint8_t *text, uint8_t length) {
    uint8_t at = 0;
    while (at < length) {
        const uint8_t first = text[at++];
        uint8_t more = 0;
        uint8_t low = 0x80;
        uint8_t high = 0xBF;
        if (first >= 0xC2 && first <= 0xDF) {
            more = 1;
        } else if (first >= 0xE0 && first <= 0xEF) {
            more = 2;
            if (first == 0xE0)
                low = 0xA0; /* else it would be one of two bytes */
            if (first == 0xED)
                high = 0x9F; /* half of a pair of UTF-16 */
        } else if (first >= 0xF0 && first <= 0xF4) {
            more = 3;
            if (first == 0xF0)
                low = 0x90;
            if (first == 0xF4)
                high = 0x8F;
        } else if (first < 0x20 || first >= 0x7F) {
            return false;
        }
        for (; more != 0; more--, at++) {
            if (at == length || text[at] < low || text[at] > high)
                return false;
            low = 0x80;
            high = 0xBF;
        }
    }
    return true;
}

static uint8_t write_topic(char *topic, const uint8_t *text, uint8_t length) {
    if (length > J2A_TRANSD_MAX_TOPIC)
        return J2A_TRANSD_BAD_LENGTH;
    if (!is_text(text, length))
        return J2A_TRANSD_BAD_VALUE;
    topic[length] = '\0';
    while (length-- != 0)
        topic[length] = (char)text[length];
    return 0;
}

static void enable(const j2a_transducer *t, bool is_enabled) {
    j2a_sensor *const sensor = t->sensor;
    j2a_queue *const queue = t->queue;
    if (!sensor->is_enabled && is_enabled)
        sensor->is_fresh = false;
    sensor->is_enabled = is_enabled;
    while (!is_enabled && t->depth != 0 && queue->tail != sensor->head) {
        queue->take_at = (uint8_t)(queue->take_at + 1 == t->depth ? 0 : queue->take_at + 1);
        queue->tail++;
        queue->dropped++;
    }
}

static void write_decimation(const j2a_transducer *t, uint8_t every) {
    volatile uint8_t *const setting = t->decimation;
    uint8_t i;
    for (i = 0; i < t->channels; i++) /* first, else a driver would compare what was counted for the old setting */
        setting[1 + i] = 0;
    setting[0] = every;
}

/* Drivers may compare meanwhile, so the new limit becomes the one that is not in use. */
static void write_threshold(const j2a_transducer *t, const uint8_t *limit) {
    const uint8_t which = t->threshold[0] == 0;
    write_value(t->threshold + 1 + (which ? t->size : 0), limit, t->size);
    *(volatile uint8_t *)t->threshold = which;
}

static bool has_item(const j2a_transducer *t, uint8_t item, bool is_write) {
    switch (item) {
    case J2A_TRANSD_SAMPLE:
        return !is_write && t->depth == 0;
    case J2A_TRANSD_ENABLED:
    case J2A_TRANSD_PERIOD:
        return t->sensor != 0;
    case J2A_TRANSD_DECIMATION:
        return t->decimation != 0;
    case J2A_TRANSD_THRESHOLD:
        return t->threshold != 0;
    case J2A_TRANSD_TOPIC:
        return t->topic != 0;
    case J2A_TRANSD_WATCHDOG:
        return t->watchdog != 0;
    case J2A_TRANSD_SET:
        return is_write && t->set;
    case J2A_TRANSD_TRIGGER:
        return is_write && t->trigger;
    case J2A_TRANSD_TIME:
        return !is_write;
#if J2A_WITH_SAVE
    case J2A_TRANSD_SAVE:
        return true;
#endif
    default:
        return false;
    }
}

/* Writes an item that the transducer has; returns the code of the reply. */
static uint8_t write_item(const j2a_transducer *t, uint8_t item, const uint8_t *value, uint8_t length) {
    static const uint8_t J2A_FLASH sizes[] = {0, 1, 4, 1, 0, 0, 2, 0, J2A_TIME_BYTES};
    uint8_t size;
#if J2A_WITH_SAVE
    if (item == J2A_TRANSD_SAVE)
        return j2a_save(t, value, length);
#endif
    size = item == J2A_TRANSD_THRESHOLD ? t->size : j2a_flash_u8(&sizes[item]);
    if (size != 0 && length != size)
        return J2A_TRANSD_BAD_LENGTH;
    switch (item) {
    case J2A_TRANSD_ENABLED:
        if (value[0] > 1)
            return J2A_TRANSD_BAD_VALUE;
        enable(t, value[0] != 0);
        return 0;
    case J2A_TRANSD_PERIOD:
        t->sensor->period_us = j2a_get_u32(value);
        return 0;
    case J2A_TRANSD_DECIMATION:
        if (value[0] == 0)
            return J2A_TRANSD_BAD_VALUE;
        write_decimation(t, value[0]);
        return 0;
    case J2A_TRANSD_THRESHOLD:
        if (is_below_zero(t, value))
            return J2A_TRANSD_BAD_VALUE;
        write_threshold(t, value);
        return 0;
    case J2A_TRANSD_TOPIC:
        return write_topic(t->topic, value, length);
    case J2A_TRANSD_WATCHDOG:
        t->watchdog->limit_ms = j2a_get_u16(value);
        return 0;
    case J2A_TRANSD_SET:
        return set_channels(t, value, length);
    default: /* TRIGGER */
        if (is_late(t->trigger))
            t->start();
        has_orders = true;
        t->trigger->due_us = j2a_get_u64(value);
        t->trigger->waits = t->trigger->due_us > clock_us();
        if (!t->trigger->waits)
            t->start();
        return 0;
    }
}

/* Puts an item that the transducer has into a payload; returns its bytes. */
static uint8_t read_item(const j2a_transducer *t, uint8_t item, uint8_t *payload) {
    uint8_t length = 0;
    switch (item) {
    case J2A_TRANSD_SAMPLE:
        return copy_sample(t, payload);
    case J2A_TRANSD_ENABLED:
        payload[0] = t->sensor->is_enabled;
        return 1;
    case J2A_TRANSD_PERIOD:
        j2a_put_u32(payload, t->sensor->period_us);
        return 4;
    case J2A_TRANSD_DECIMATION:
        payload[0] = t->decimation[0];
        return 1;
    case J2A_TRANSD_THRESHOLD:
        write_value(payload, t->threshold + 1 + (t->threshold[0] != 0 ? t->size : 0), t->size);
        return t->size;
    case J2A_TRANSD_TOPIC:
        for (; t->topic[length] != '\0'; length++)
            payload[length] = (uint8_t)t->topic[length];
        return length;
    case J2A_TRANSD_WATCHDOG:
        j2a_put_u16(payload, t->watchdog->limit_ms);
        return 2;
    case J2A_TRANSD_TIME:
        j2a_put_u64(payload, now_us());
        return J2A_TIME_BYTES;
#if J2A_WITH_SAVE
    case J2A_TRANSD_SAVE:
        payload[0] = j2a_save_state(t);
        return 1;
#endif
    default: /* SET, TRIGGER */
        return 0;
    }
}

#if J2A_WITH_SAVE
uint8_t j2a_read_item(const j2a_transducer *t, uint8_t item, uint8_t *payload) {
    return has_item(t, item, false) ? read_item(t, item, payload) : 0;
}

uint8_t j2a_write_item(const j2a_transducer *t, uint8_t item, const uint8_t *value, uint8_t length) {
    return has_item(t, item, true) ? write_item(t, item, value, length) : J2A_TRANSD_NO_ITEM;
}
#endif

/* A bool from the host may be any byte (J2A-TYPE-002); what is compared, kept and sent is 0 or 1. */
static void tidy(const j2a_transducer *t, uint8_t item, uint8_t *value, uint8_t length) {
    uint8_t at = item == J2A_TRANSD_SET ? 1 + J2A_TIME_BYTES : 0;
    if (!t->tidy || (item != J2A_TRANSD_SET && item != J2A_TRANSD_THRESHOLD))
        return;
    for (; at + t->size <= length; at = (uint8_t)(at + t->size))
        t->tidy(value + at);
}

uint8_t j2a_transd(uint8_t *const length, uint8_t **const payload) {
    uint8_t *const bytes = *payload;
    const uint8_t count = *length;
    const uint8_t item = bytes[1];
    j2a_transducer t;
    uint8_t index = 0;
    uint8_t code;

    *length = 0;
    if (count < 2)
        return J2A_TRANSD_BAD_LENGTH;
    while (index < j2a_transducer_count && j2a_flash_u8(&j2a_transducers[index].id) != bytes[0])
        index++;
    if (index == j2a_transducer_count)
        return J2A_TRANSD_NO_ID;
    load(&t, index);
    if (!has_item(&t, item, count > 2))
        return J2A_TRANSD_NO_ITEM;
    tidy(&t, item, bytes + 2, (uint8_t)(count - 2));
    service = BUSY; /* a driver may take its time, and what it calls may send */
    code = count > 2 ? write_item(&t, item, bytes + 2, (uint8_t)(count - 2)) : 0;
    if (code == 0)
        *length = read_item(&t, item, bytes);
    service = FREE;
    return code;
}

#endif
