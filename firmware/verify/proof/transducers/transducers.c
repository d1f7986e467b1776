/* The transducers of transds.def: one call of a driver, of the main loop or of the host, from any state that is sound.
 * In: any value, time, request and offset; any contents of what is kept, but what sound() says. Out: a state that is sound
 * again. Since the one in which a device starts is, every state is, after any calls in any order.
 * Options: of the clock, of stamps, of the room and of settings that stay; what they call is a model of it. */
#include "__fc_builtin.h"
#include "numbers.h"

/* Their functions are static. Before any.h, behind which volatile is what it says. */
#include "ext/j2a_transducers.c"
#include "j2a_transds_table.c"

#include "any.h"

volatile uint8_t any_u8;
volatile uint16_t any_u16;
volatile uint32_t any_u32;

#include "any_numbers.h"

#define ALL j2a_transducers_listed

/* ------------------------------------------------------------------------- the core's model ------ */

uint64_t j2a_port_time_us(void) {
    return (uint64_t)any_u32 << 32 | any_u32;
}

#if J2A_WITH_SYNC
uint64_t j2a_clock_us(void) {
    return j2a_port_time_us();
}

bool j2a_clock_is_due(uint64_t due_us) {
    (void)due_us;
    return any_bool;
}
#endif

#if J2A_PORT_STAMP && !J2A_WITH_SYNC
void j2a_port_stamp(uint8_t *stamp) {
    Frama_C_make_unknown((char *)stamp, J2A_STAMP_BYTES);
}

uint64_t j2a_port_stamp_us(const uint8_t *stamp) {
    //@ check \initialized(stamp + (0 .. J2A_STAMP_BYTES - 1));
    (void)stamp;
    return j2a_port_time_us();
}
#endif

#if J2A_PORT_SHARES_ROOM
static uint8_t *shared_room;

uint8_t *j2a_rx_room(void) {
    return shared_room;
}
#endif

static void wait_for_host(void);

void j2a_send_sif(uint8_t opcode, uint8_t length, const uint8_t *payload) {
    //@ check opcode <= J2A_TRANSD_MAX_ID;
    //@ check length == 0 || \initialized(payload + (0 .. length - 1));
    (void)opcode;
    (void)length;
    (void)payload;
    if (any_bool)
        wait_for_host();
}

/* ------------------------------------------------------------------------- drivers ------ */

#define DRIVER(prefix, type) \
    static void (*prefix##_cb) J2A_VALUE_OF(type); \
    void prefix##_set_cb(void (*callback) J2A_VALUE_OF(type)) { \
        prefix##_cb = callback; \
    }
DRIVER(plain, i16)
DRIVER(queued, u16)
DRIVER(level, f32)
DRIVER(imu, motion)

static motion any_motion(void) {
    motion value = {{0}, 0};
    value.rate[0] = (int16_t)any_u16;
    value.rate[1] = (int16_t)any_u16;
    value.flag = any_bool;
    return value;
}

static float any_float(void) {
    const uint32_t bits = any_u32;
    float number;
    uint8_t i;
    for (i = 0; i < sizeof number; i++)
        ((uint8_t *)&number)[i] = ((const uint8_t *)&bits)[i];
    return number;
}

void level_trigger(void) {
    level_cb(any_u8, any_float());
}

void imu_trigger(void) {
    const motion value = any_motion();
    imu_cb(any_u8, &value);
}

void servo_set(uint8_t channel, int8_t value) {
    //@ check channel < 2;
    (void)channel;
    (void)value;
}

void pose_set(uint8_t channel, const motion *value) {
    //@ check channel == 0 && \initialized(&value->rate[0 .. 1]) && \initialized(&value->flag);
    (void)channel;
    (void)value;
}

void valve_set(uint8_t channel, float value) {
    //@ check channel == 0;
    (void)channel;
    (void)value;
}

/* ------------------------------------------------------------------------- what is kept ------ */

static void forget_bytes(volatile uint8_t *bytes, uint16_t count) {
    Frama_C_make_unknown((char *)bytes, count);
}

static uint8_t below(uint8_t end) {
    const uint8_t number = any_u8;
    return number < end ? number : 0;
}

/* What changes where orders are due and watchdogs run out. */
static void forget_orders(const j2a_transducer *t) {
    uint8_t i;
    if (t->trigger) {
        t->trigger->due_us = j2a_port_time_us();
        t->trigger->waits = any_bool;
    }
    for (i = 0; t->waiting && i < t->channels; i++) {
        t->waiting[i].due_us = j2a_port_time_us();
        t->waiting[i].waits = any_bool;
    }
    if (t->waiting)
        forget_bytes(t->slots, (uint16_t)(t->channels * (8 + t->size)));
    if (t->watchdog) {
        t->watchdog->limit_ms = any_u16;
        t->watchdog->is_safe = any_bool;
    }
}

/* What j2a_waiting(), which is a call of its own below, leaves behind. */
static void wait_for_host(void) {
    uint8_t i;
    for (i = 0; i < ALL; i++)
        forget_orders(&j2a_transducers[i]);
    j2a_is_heard = any_bool;
    heard_ms = any_u32;
    has_orders = any_bool;
    service = LOOKED;
}

/* Any state that is sound: an index of a queue is inside it, a topic ends, a choice is 0 or 1. */
static void forget(const j2a_transducer *t) {
    if (t->sensor) {
        t->sensor->reference_us = j2a_port_time_us();
        t->sensor->period_us = any_u32;
        t->sensor->head = any_u8;
        t->sensor->is_fresh = any_bool;
        t->sensor->is_enabled = any_bool;
    }
    if (t->queue) {
        t->queue->tail = any_u8;
        t->queue->full = any_u16;
        t->queue->dropped = any_u16;
        t->queue->put_at = below(t->depth);
        t->queue->take_at = below(t->depth);
    }
    forget_bytes(t->slots, (uint16_t)(t->depth ? t->depth * (9 + t->size) : t->channels * (8 + t->size)));
    if (t->decimation)
        forget_bytes(t->decimation, (uint16_t)(1 + t->channels));
    if (t->threshold) {
        forget_bytes(t->threshold + 1, (uint16_t)(2 * t->size));
        t->threshold[0] = any_bool;
    }
    if (t->last)
        forget_bytes(t->last, (uint16_t)(t->channels * (1 + t->size)));
    if (t->topic)
        forget_bytes((uint8_t *)t->topic, J2A_TRANSD_MAX_TOPIC);
    if (t->values)
        forget_bytes(t->values, (uint16_t)(t->channels * t->size));
    forget_orders(t);
}

static void check_sound(const j2a_transducer *t) {
    //@ check t->queue == \null || t->queue->put_at < t->depth;
    //@ check t->queue == \null || t->queue->take_at < t->depth;
    //@ check t->topic == \null || t->topic[J2A_TRANSD_MAX_TOPIC] == 0;
    //@ check t->threshold == \null || t->threshold[0] <= 1;
    (void)t;
}

/* ------------------------------------------------------------------------- settings that stay ------ */

#if J2A_WITH_SAVE
/* The room that save.c has for each setting. Longer is what a transducer does not have. */
static uint8_t room_of(const j2a_transducer *t, uint8_t item) {
    static const uint8_t rooms[] = {0, 1, 4, 1, 0, J2A_TRANSD_MAX_TOPIC, 2};
    return item == J2A_TRANSD_THRESHOLD ? t->size : rooms[item];
}

static uint8_t any_setting(void) {
    return (uint8_t)(J2A_TRANSD_ENABLED + any_u8 % J2A_TRANSD_WATCHDOG);
}

/* A setting that was kept: nothing is read of it but the bytes that it has. */
static void restore(void) {
    uint8_t value[J2A_TRANSD_MAX_TOPIC];
    uint8_t index = any_u8 % ALL;
    uint8_t item = any_setting();
    uint8_t length = (uint8_t)(1 + any_u8 % J2A_TRANSD_MAX_TOPIC);
    //@ split index;
    //@ split item;
    //@ split length;
    forget_bytes(value + sizeof value - length, length);
    (void)j2a_write_item(&j2a_transducers[index], item, value + sizeof value - length, length);
}

/* A setting that is to be kept: no more is written than there is room for. */
static void gather(void) {
    uint8_t record[J2A_TRANSD_MAX_TOPIC];
    uint8_t index = any_u8 % ALL;
    uint8_t item = any_setting();
    uint8_t *at;
    uint8_t room;
    uint8_t length;
    //@ split index;
    //@ split item;
    room = room_of(&j2a_transducers[index], item);
    at = record + sizeof record - room;
    length = j2a_read_item(&j2a_transducers[index], item, at);
    //@ check length <= room;
    (void)length;
}

void j2a_save_start(void) {
    restore();
}

void j2a_save_turn(void) {
}

uint8_t j2a_save(const j2a_transducer *t, const uint8_t *value, uint8_t length) {
    //@ check length > 0 && \initialized(value + (0 .. length - 1));
    (void)t;
    (void)value;
    (void)length;
    return any_bool ? 0 : J2A_TRANSD_BUSY;
}

uint8_t j2a_save_state(const j2a_transducer *t) {
    (void)t;
    return any_u8;
}
#endif

/* ------------------------------------------------------------------------- calls ------ */

static void sense(void) {
    const motion value = any_motion();
    const uint8_t channel = any_u8;
    switch (any_u8) {
    case 0:
        plain_cb(channel, (int16_t)any_u16);
        break;
    case 1:
        queued_cb(channel, any_u16);
        break;
    case 2:
        level_cb(channel, any_float());
        break;
    default:
        imu_cb(channel, &value);
    }
}

/* Eva takes each transducer, item and length of a request apart, else it would mix what belongs to several. */
static void ask(void) {
    uint8_t room[J2A_ROOM];
    uint8_t *payload = room;
    uint8_t id = any_u8;
    uint8_t item = any_u8;
    uint8_t length = any_u8;
    uint8_t code;
    if (length > J2A_ROOM)
        return;
    if (id > ALL)
        id = ALL; /* there is none with it */
    if (item > J2A_TRANSD_TIME)
        item = J2A_TRANSD_TIME + 1;
    forget_bytes(room, sizeof room);
    //@ split id;
    //@ split item;
    //@ split length;
    room[0] = id;
    room[1] = item;
    code = j2a_transd(&length, &payload);
    //@ check code <= (J2A_WITH_SAVE ? J2A_TRANSD_BUSY : J2A_TRANSD_BAD_VALUE);
    //@ check code == 0 || length == 0;
    //@ check payload == (uint8_t *)room && length <= J2A_ROOM;
    (void)code;
}

/* Also those that no transducer of transds.def needs, because its type has no bool. */
#define TIDY(name) j2a_tidy_of_##name(value + sizeof value - j2a_bytes_of_##name);
static void tidy_any(void) {
    uint8_t value[j2a_bytes_of_imu];
    forget_bytes(value, sizeof value);
    TIDY(plain)
    TIDY(queued)
    TIDY(level)
    TIDY(imu)
    TIDY(servo)
    TIDY(pose)
    TIDY(valve)
}

static void describe(void) {
    uint8_t room[J2A_ROOM_MANY];
    uint8_t *data = room;
    uint32_t offset = any_u32;
    uint8_t length = 0;
    bool is_last = any_bool;
    (void)j2a_get_transds(&is_last, any_bool, &offset, &length, &data);
    //@ check length <= J2A_ROOM_MANY;
}

/* From any state that is sound, one call: so the calls need no order, and none knows of another. */
static void forget_all(void) {
    uint8_t i;
    for (i = 0; i < ALL; i++)
        forget(&j2a_transducers[i]);
    j2a_is_heard = any_bool;
    heard_ms = any_u32;
    next = any_u8 % (ALL + 1);
    has_orders = any_bool;
    service = below(LOOKED + 1);
}

static void check_all(void) {
    uint8_t i;
    for (i = 0; i < ALL; i++)
        check_sound(&j2a_transducers[i]);
}

static void turn(void) {
#if J2A_PORT_SHARES_ROOM
    uint8_t room[J2A_ROOM]; /* nothing in it was written */
    uint8_t is_free = any_bool;
    //@ split is_free;
    shared_room = is_free ? room : 0;
#endif
    //@ split next;
    transds_process();
#if J2A_PORT_SHARES_ROOM
    shared_room = 0;
#endif
    //@ check next <= ALL;
}

int main(void) {
    transds_init();
    check_all();
    forget_all();
    switch (any_u8) {
    case 0:
        describe();
        break;
    case 1:
        sense();
        break;
    case 2:
        ask();
        break;
#if J2A_WITH_SYNC
    case 3:
        j2a_transds_move(j2a_port_time_us());
        break;
#endif
#if J2A_WITH_SAVE
    case 4:
        restore();
        break;
    case 5:
        gather();
        break;
#endif
    case 6:
        j2a_waiting();
        break;
    case 7:
        tidy_any();
        break;
    default:
        turn();
    }
    check_all();
    return 0;
}
