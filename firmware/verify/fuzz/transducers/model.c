/* See model.h. */
#include "model.h"

#include <math.h>
#include <string.h>

#include "j2a_options.h"
#include "values.h"

#define NONE .threshold = -1
const described model_of[TRANSDUCERS] = {
    {0, 3, 2, 'i', .is_sensor = true, NONE, .period_us = 1000, .has_na = true, .na = -1},
    {1, 3, 2, 'u', .is_sensor = true, NONE, .depth = 4, .period_us = 1000},
    {2, 2, 4, 'i', .is_sensor = true, .decimation = 2, .threshold = 3, .topic = "tuned", .has_na = true,
     .na = 2147483647.0},
    {3, 1, 8, 'u', .is_sensor = true, .threshold = 1, .depth = 2, .period_us = 1000, .has_na = true, .na = 0},
    {4, 2, 4, 'f', .is_sensor = true, .threshold = 0.5, .is_disabled = true, .has_na = true, .na = NAN},
    {5, 1, 8, 'd', .is_sensor = true, .threshold = 0.25, .depth = 3, .decimation = 1},
    {6, 1, 12, 's', .is_sensor = true, NONE, .has_trigger = true, .period_us = 4294967295},
    {7, 1, 1, 'i', .is_sensor = true, NONE, .has_trigger = true, .depth = 5},
    {254, 2, 1, 'u', .is_sensor = true, .threshold = 0, .decimation = 1, .depth = 255, .has_na = true, .na = 255},
    {10, 2, 1, 'i', NONE, .has_watchdog = true, .watchdog_ms = 3, .topic = "s", .has_na = true, .na = 5,
     .has_range = true, .low = -100, .high = 100},
    {11, 1, 4, 'f', NONE, .has_range = true, .low = -1.5, .high = 1.5},
    {12, 1, 12, 's', NONE, .has_watchdog = true},
    {13, 5, 2, 'u', NONE, .has_watchdog = true, .watchdog_ms = 65535, .has_na = true, .na = 40000, .has_range = true,
     .low = 100, .high = 60000},
};

typedef struct {
    uint64_t time_us;
    uint8_t channel;
    uint8_t value[MOST_SIZE];
} entry;

typedef struct {
    bool is_enabled;
    uint32_t period_us;
    uint8_t decimation;
    uint8_t threshold[MOST_SIZE];
    char topic[J2A_TRANSD_MAX_TOPIC + 1];
    uint16_t limit_ms;
} settings;

static struct {
    settings is;
    bool is_fresh, has_reference;
    uint64_t reference_us;
    uint8_t counts[MOST_CHANNELS];
    bool has_last[MOST_CHANNELS];
    uint8_t last[MOST_CHANNELS][MOST_SIZE];
    entry newest[MOST_CHANNELS];
    entry queue[255];
    size_t queued;
    uint64_t lost;
    bool waits[MOST_CHANNELS]; /* of an actuator, [0] the trigger of a sensor */
    uint64_t due_us[MOST_CHANNELS];
    uint8_t waiting[MOST_CHANNELS][MOST_SIZE];
    bool is_safe;
} now_of[TRANSDUCERS];
static settings kept_of[TRANSDUCERS];
static bool is_kept[TRANSDUCERS];
static uint8_t keeping; /* whose settings are being kept, TRANSDUCERS for none */
static uint64_t heard_us, ahead_us;
static bool is_heard;

static uint64_t time_of(uint64_t now_us) {
    return now_us + ahead_us ? now_us + ahead_us : 1;
}

/* Of a sample SIF, which goes by local time. */
static uint64_t local_of(uint64_t now_us) {
    return now_us ? now_us : 1;
}

/* ------------------------------------------------------------------------- sensors ------ */

static void begin(void) {
    uint8_t i;
    memset(now_of, 0, sizeof now_of);
    keeping = TRANSDUCERS;
    ahead_us = 0;
    for (i = 0; i < TRANSDUCERS; i++) {
        const described *const d = &model_of[i];
        now_of[i].is.is_enabled = !d->is_disabled;
        now_of[i].is.period_us = d->period_us;
        now_of[i].is.decimation = d->decimation;
        now_of[i].is.limit_ms = d->watchdog_ms;
        if (d->threshold >= 0)
            value_put(d, d->threshold, now_of[i].is.threshold);
        if (d->topic)
            strcpy(now_of[i].is.topic, d->topic);
    }
}

void model_reset(void) {
    begin();
    memset(is_kept, 0, sizeof is_kept);
    heard_us = 0;
    is_heard = false;
}

void model_restart(uint64_t now_us) {
    uint8_t i;
    begin();
    model_hear(now_us);
    for (i = 0; i < TRANSDUCERS; i++)
        if (is_kept[i])
            memcpy(&now_of[i].is, &kept_of[i], sizeof(settings));
}

static uint64_t moved(uint64_t time_us, uint64_t to_us) {
    const __int128 sum = (__int128)time_us + to_us - ahead_us;
    return sum < 0 ? 0 : sum > UINT64_MAX ? UINT64_MAX : (uint64_t)sum;
}

void model_clock(uint64_t to_us) {
    uint8_t i, channel;
    for (i = 0; i < TRANSDUCERS; i++)
        for (channel = 0; channel < MOST_CHANNELS; channel++)
            now_of[i].due_us[channel] = moved(now_of[i].due_us[channel], to_us);
    ahead_us = to_us;
}

void model_sense(uint8_t index, uint8_t channel, const uint8_t *value, uint64_t now_us) {
    const described *const d = &model_of[index];
    if (channel >= d->channels)
        return;
    if (d->decimation) {
        if (++now_of[index].counts[channel] < now_of[index].is.decimation)
            return;
        now_of[index].counts[channel] = 0;
    }
    if (d->depth && !now_of[index].is.is_enabled)
        return;
    if (d->threshold >= 0) {
        if (now_of[index].has_last[channel] &&
            !value_differs(d, value, now_of[index].last[channel], now_of[index].is.threshold))
            return;
        now_of[index].has_last[channel] = true;
        memcpy(now_of[index].last[channel], value, d->size);
    }
    entry taken = {.time_us = time_of(now_us), .channel = channel};
    memcpy(taken.value, value, d->size);
    if (d->depth == 0) {
        now_of[index].newest[channel] = taken;
        now_of[index].is_fresh = true;
    } else if (now_of[index].queued == d->depth) {
        now_of[index].lost++;
    } else {
        now_of[index].queue[now_of[index].queued++] = taken;
    }
}

static uint8_t add(uint8_t *to, uint8_t at, const entry *one, uint8_t size) {
    uint8_t i;
    for (i = 0; i < 8; i++)
        to[at + i] = (uint8_t)(one->time_us >> 8 * i);
    memcpy(to + at + 8, one->value, size);
    return (uint8_t)(at + 8 + size);
}

/* When the next sample SIF is due, now for the first one. */
static uint64_t due_of(uint8_t index, uint64_t now_us) {
    return now_of[index].has_reference ? now_of[index].reference_us + now_of[index].is.period_us : local_of(now_us);
}

static size_t in_one_sif(uint8_t index) {
    const size_t most = (size_t)(MOST_BYTES - 2) / (size_t)(9 + model_of[index].size);
    return now_of[index].queued < most ? now_of[index].queued : most;
}

bool model_is_due(uint8_t index, uint64_t now_us, uint8_t *payload, uint8_t *length) {
    const described *const d = &model_of[index];
    size_t i;
    *length = 0;
    if (!d->is_sensor || !now_of[index].is.is_enabled || local_of(now_us) < due_of(index, now_us))
        return false;
    if (d->depth == 0) {
        for (i = 0; i < d->channels; i++)
            *length = add(payload, *length, &now_of[index].newest[i], d->size);
        return now_of[index].is_fresh;
    }
    payload[0] = (uint8_t)now_of[index].lost;
    payload[1] = (uint8_t)(now_of[index].lost >> 8);
    *length = 2;
    for (i = 0; i < in_one_sif(index); i++) {
        payload[(*length)++] = now_of[index].queue[i].channel;
        *length = add(payload, *length, &now_of[index].queue[i], d->size);
    }
    return now_of[index].queued != 0;
}

void model_sent(uint8_t index, uint64_t now_us) {
    const uint64_t due_us = due_of(index, now_us);
    const size_t gone = model_of[index].depth ? in_one_sif(index) : 0;
    now_of[index].queued -= gone;
    memmove(now_of[index].queue, now_of[index].queue + gone, now_of[index].queued * sizeof(entry));
    now_of[index].is_fresh = false;
    now_of[index].reference_us =
        local_of(now_us) < due_us + now_of[index].is.period_us ? due_us : local_of(now_us);
    now_of[index].has_reference = true;
}

/* ------------------------------------------------------------------------- actuators ------ */

static void set(uint8_t index, uint8_t channel, const uint8_t *value, uint64_t now_us) {
    entry *const newest = &now_of[index].newest[channel];
    model_call call = {.index = index, .channel = channel};
    newest->time_us = time_of(now_us);
    memcpy(newest->value, value, model_of[index].size);
    memcpy(call.value, value, model_of[index].size);
    model_calls(&call);
}

static void start(uint8_t index) {
    model_call call = {.index = index, .is_start = true};
    now_of[index].waits[0] = false;
    model_calls(&call);
}

void model_hear(uint64_t now_us) {
    uint8_t i;
    heard_us = now_us;
    is_heard = true;
    for (i = 0; i < TRANSDUCERS; i++)
        now_of[i].is_safe = false;
}

void model_turn(uint64_t now_us) {
    uint8_t i, channel;
    if (is_heard)
        heard_us = now_us; /* the core reads its clock in the turn behind the request */
    is_heard = false;
    keeping = TRANSDUCERS;
    for (i = 0; i < TRANSDUCERS; i++) {
        const described *const d = &model_of[i];
        if (d->has_trigger && now_of[i].waits[0] && now_of[i].due_us[0] <= now_us + ahead_us)
            start(i);
        if (d->has_watchdog && now_of[i].is.limit_ms == 0)
            now_of[i].is_safe = false;
        /* In whole milliseconds of the clock, and never early. */
        if (d->has_watchdog && now_of[i].is.limit_ms && !now_of[i].is_safe &&
            now_us / 1000 - heard_us / 1000 > now_of[i].is.limit_ms) {
            uint8_t value[MOST_SIZE] = {0};
            if (d->has_na)
                value_put(d, d->na, value);
            now_of[i].is_safe = true;
            for (channel = 0; channel < d->channels; channel++) {
                now_of[i].waits[channel] = false;
                set(i, channel, value, now_us);
            }
        }
        for (channel = 0; !d->is_sensor && channel < d->channels; channel++) {
            if (now_of[i].waits[channel] && now_of[i].due_us[channel] <= now_us + ahead_us) {
                now_of[i].waits[channel] = false;
                set(i, channel, now_of[i].waiting[channel], now_us);
            }
        }
    }
}

/* ------------------------------------------------------------------------- requests ------ */

static bool has(const described *d, uint8_t item, bool is_write) {
    switch (item) {
    case J2A_TRANSD_SAMPLE: return !is_write && !d->depth;
    case J2A_TRANSD_ENABLED: return d->is_sensor;
    case J2A_TRANSD_PERIOD: return d->is_sensor;
    case J2A_TRANSD_DECIMATION: return d->decimation;
    case J2A_TRANSD_THRESHOLD: return d->threshold >= 0;
    case J2A_TRANSD_TOPIC: return d->topic;
    case J2A_TRANSD_WATCHDOG: return d->has_watchdog;
    case J2A_TRANSD_SET: return is_write && !d->is_sensor;
    case J2A_TRANSD_TRIGGER: return is_write && d->has_trigger;
    case J2A_TRANSD_TIME: return !is_write;
    case J2A_TRANSD_SAVE: return J2A_WITH_SAVE;
    default: return false;
    }
}

static uint64_t number_of(const uint8_t *bytes, size_t size) {
    uint64_t number = 0;
    while (size-- > 0)
        number = number << 8 | bytes[size];
    return number;
}

static uint8_t write_set(uint8_t index, const uint8_t *bytes, size_t length, uint64_t now_us) {
    const described *const d = &model_of[index];
    const uint64_t due_us = number_of(bytes + 1, 8);
    size_t count, i;
    if (length < 9u + d->size || (length - 9) % d->size)
        return J2A_TRANSD_BAD_LENGTH;
    count = (length - 9) / d->size;
    if (bytes[0] + count > d->channels)
        return J2A_TRANSD_BAD_VALUE;
    for (i = 0; i < count; i++)
        if (!value_is_in_range(d, bytes + 9 + i * d->size))
            return J2A_TRANSD_BAD_VALUE;
    for (i = 0; i < count; i++) {
        const uint8_t channel = (uint8_t)(bytes[0] + i);
        const uint8_t *const value = bytes + 9 + i * d->size;
        now_of[index].waits[channel] = due_us > now_us + ahead_us;
        now_of[index].due_us[channel] = due_us;
        memcpy(now_of[index].waiting[channel], value, d->size);
        if (due_us <= now_us + ahead_us)
            set(index, channel, value, now_us);
    }
    return 0;
}

/* The memory of turns.c takes all bytes at once, in the next turn, and nothing before that is asked of it. */
static uint8_t save(uint8_t index, uint8_t state) {
    if (state != J2A_TRANSD_SAVED)
        return J2A_TRANSD_BAD_VALUE;
    if (keeping != TRANSDUCERS)
        return J2A_TRANSD_BUSY;
    if (is_kept[index] && memcmp(&kept_of[index], &now_of[index].is, sizeof(settings)) == 0)
        return 0;
    is_kept[index] = true;
    memcpy(&kept_of[index], &now_of[index].is, sizeof(settings)); /* with what is between its parts */
    keeping = index;
    return 0;
}

static uint8_t state_of(uint8_t index) {
    return keeping == index ? J2A_TRANSD_SAVING : is_kept[index] ? J2A_TRANSD_SAVED : J2A_TRANSD_NOT_SAVED;
}

static uint8_t written(uint8_t index, uint8_t item, const uint8_t *bytes, size_t length, uint64_t now_us) {
    const described *const d = &model_of[index];
    const uint8_t sizes[] = {0, 1, 4, 1, d->size, 0, 2, 0, 8, 1};
    const uint64_t number = number_of(bytes, length < 8 ? length : 8);
    if (sizes[item] && length != sizes[item])
        return J2A_TRANSD_BAD_LENGTH;
    switch (item) {
    case J2A_TRANSD_ENABLED:
        if (number > 1)
            return J2A_TRANSD_BAD_VALUE;
        if (!number) {
            now_of[index].lost += now_of[index].queued;
            now_of[index].queued = 0;
        }
        if (!number || !now_of[index].is.is_enabled)
            now_of[index].is_fresh = false;
        now_of[index].is.is_enabled = number != 0;
        break;
    case J2A_TRANSD_PERIOD:
        now_of[index].is.period_us = (uint32_t)number;
        break;
    case J2A_TRANSD_DECIMATION:
        if (number == 0)
            return J2A_TRANSD_BAD_VALUE;
        now_of[index].is.decimation = (uint8_t)number;
        memset(now_of[index].counts, 0, sizeof now_of[index].counts);
        break;
    case J2A_TRANSD_THRESHOLD:
        if (!value_is_limit(d, bytes))
            return J2A_TRANSD_BAD_VALUE;
        memcpy(now_of[index].is.threshold, bytes, d->size);
        break;
    case J2A_TRANSD_TOPIC:
        if (length > J2A_TRANSD_MAX_TOPIC)
            return J2A_TRANSD_BAD_LENGTH;
        if (!value_is_text(bytes, length))
            return J2A_TRANSD_BAD_VALUE;
        memset(now_of[index].is.topic, 0, sizeof now_of[index].is.topic);
        memcpy(now_of[index].is.topic, bytes, length);
        break;
    case J2A_TRANSD_WATCHDOG:
        now_of[index].is.limit_ms = (uint16_t)number;
        break;
    case J2A_TRANSD_SET:
        return write_set(index, bytes, length, now_us);
    case J2A_TRANSD_SAVE:
        return save(index, bytes[0]);
    default:
        now_of[index].due_us[0] = number;
        now_of[index].waits[0] = number > now_us + ahead_us;
        if (!now_of[index].waits[0])
            start(index);
    }
    return 0;
}

static uint8_t read(uint8_t index, uint8_t item, uint8_t *reply, uint64_t now_us) {
    const described *const d = &model_of[index];
    const uint64_t numbers[] = {0, now_of[index].is.is_enabled, now_of[index].is.period_us, now_of[index].is.decimation, 0, 0,
                                now_of[index].is.limit_ms, 0, 0, state_of(index), time_of(now_us)};
    const uint8_t sizes[] = {0, 1, 4, 1, 0, 0, 2, 0, 0, J2A_WITH_SAVE, 8};
    uint8_t length = 0;
    uint8_t i;
    for (i = 0; item == J2A_TRANSD_SAMPLE && i < d->channels; i++)
        length = add(reply, length, &now_of[index].newest[i], d->size);
    if (item == J2A_TRANSD_THRESHOLD)
        memcpy(reply, now_of[index].is.threshold, length = d->size);
    if (item == J2A_TRANSD_TOPIC)
        memcpy(reply, now_of[index].is.topic, length = (uint8_t)strlen(now_of[index].is.topic));
    for (i = 0; i < sizes[item]; i++)
        reply[length++] = (uint8_t)(numbers[item] >> 8 * i);
    return length;
}

uint8_t model_request(const uint8_t *request, uint8_t length, uint8_t *reply, uint8_t *reply_length,
                      uint64_t now_us) {
    uint8_t index, code;
    *reply_length = 0;
    if (length < 2)
        return J2A_TRANSD_BAD_LENGTH;
    index = 0;
    while (index < TRANSDUCERS && model_of[index].id != request[0])
        index++;
    if (index == TRANSDUCERS)
        return J2A_TRANSD_NO_ID;
    if (!has(&model_of[index], request[1], length > 2))
        return J2A_TRANSD_NO_ITEM;
    code = length > 2 ? written(index, request[1], request + 2, length - 2u, now_us) : 0;
    if (code == 0)
        *reply_length = read(index, request[1], reply, now_us);
    return code;
}
