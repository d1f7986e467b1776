/* The settings that stay without power: a save, one turn of it or the start, from any state that is sound, for a sensor
 * with all settings, one with few and an actuator. In: any bytes of the port's memory, any request, any settings.
 * Out: a state that is sound again. Sound is: what is being written is one of the records, at one of its bytes. */
#include "__fc_builtin.h"
#include "numbers.h"

/* Its functions are static. Before any.h, behind which volatile is what it says. */
#include "ext/j2a_save.c"

#include "any.h"

volatile uint8_t any_u8;
volatile uint16_t any_u16;
volatile uint32_t any_u32;

#include "any_numbers.h"

enum { ALL = 3, FIRST_ID = 3 };

static j2a_sensor sensors[2];
static uint8_t decimation[3];
static uint8_t threshold[17];
static char topic[J2A_TRANSD_MAX_TOPIC + 1];
static j2a_watchdog watchdog;

const j2a_transducer j2a_transducers[ALL] = {
    {.id = FIRST_ID, .channels = 2, .size = 8, .sensor = &sensors[0], .decimation = decimation, .threshold = threshold,
     .topic = topic},
    {.id = FIRST_ID + 1, .channels = 1, .size = 18, .sensor = &sensors[1], .threshold = threshold},
    {.id = FIRST_ID + 2, .channels = 1, .size = 2, .topic = topic, .watchdog = &watchdog},
};
const uint8_t j2a_transducer_count = ALL;
const char j2a_descriptors[] = "any";

/* ------------------------------------------------------------------------- the model of the rest ------ */

void j2a_stamp(uint8_t *slot) {
    (void)slot;
}

uint64_t j2a_port_time_us(void) {
    return (uint64_t)any_u32 << 32 | any_u32;
}

uint8_t j2a_port_kept(uint16_t at) {
    //@ check at < J2A_PORT_KEPT_BYTES;
    (void)at;
    return any_u8;
}

/* Behind it saving_next grows by one and saving_left becomes one less, or both stay: so their sum does. */
bool j2a_port_keep(uint16_t at, uint8_t byte) {
    //@ check saving_next + saving_left <= LONGEST + 1;
    //@ check at < J2A_PORT_KEPT_BYTES;
    (void)at;
    (void)byte;
    return any_bool;
}

uint8_t j2a_read_item(const j2a_transducer *t, uint8_t item, uint8_t *payload) {
    const uint8_t room = room_of(t, item);
    const uint8_t length = any_u8;
    if (room != 0)
        Frama_C_make_unknown((char *)payload, room);
    return length <= room ? length : room;
}

uint8_t j2a_write_item(const j2a_transducer *t, uint8_t item, const uint8_t *value, uint8_t length) {
    uint8_t sum = any_u8;
    uint8_t i;
    //@ check length > 0;
    for (i = 0; i < length; i++)
        sum = (uint8_t)(sum + value[i]); /* bytes that were written */
    (void)t;
    (void)item;
    return sum;
}

/* ------------------------------------------------------------------------- what is kept ------ */

static void forget_all(const j2a_transducer *t) {
    const uint8_t bytes = record_bytes(t);
    uint8_t done = any_u8;
    Frama_C_make_unknown((char *)record, sizeof record);
    descriptors_crc = any_u32;
    saving_id = t->id;
    saving_at = records_of(t->id);
    if (any_bool)
        saving_at = (uint16_t)(saving_at + bytes);
    if (done > bytes)
        done = bytes;
    saving_next = done;
    saving_left = (uint8_t)(bytes + 1 - done);
    saving_since_us = any_u32;
    if (any_bool) {
        saving_left = 0;
        saving_next = any_u8;
    }
}

static void check_all(void) {
    //@ check saving_left == 0 || FIRST_ID <= saving_id < FIRST_ID + ALL;
    //@ check saving_left == 0 || saving_at + LONGEST <= J2A_PORT_KEPT_BYTES;
}

/* ------------------------------------------------------------------------- calls ------ */

/* While another save runs nothing changes. Without one saving_next is only written, so any value stands for all. */
static void save(const j2a_transducer *t) {
    const uint8_t value[1] = {any_u8};
    uint8_t code;
    if (saving_left != 0) {
        code = j2a_save(t, value, any_u8);
        //@ check code != 0;
    } else {
        saving_next = 0;
        code = j2a_save(t, value, any_u8);
        //@ check saving_next + saving_left <= LONGEST + 1;
        check_all();
    }
    //@ check code <= J2A_TRANSD_BUSY;
    (void)code;
}

static void turn(const j2a_transducer *t) {
    const uint8_t bytes = record_bytes(t);
    uint8_t done = any_u8;
    if (done > bytes)
        done = bytes;
    //@ split done;
    saving_next = done;
    saving_left = (uint8_t)(bytes + 1 - done);
    j2a_save_turn();
    check_all();
}

static void tell_state(const j2a_transducer *t) {
    const uint8_t state = j2a_save_state(t);
    //@ check state == J2A_TRANSD_SAVING || state == J2A_TRANSD_SAVED || state == J2A_TRANSD_NOT_SAVED;
    (void)state;
}

int main(void) {
    uint8_t saved = any_u8 % ALL;
    uint8_t asked = any_u8 % ALL;
    //@ split saved;
    //@ split asked;
    forget_all(&j2a_transducers[saved]);
    switch (any_u8) {
    case 0:
        j2a_save_start();
        break;
    case 1:
        save(&j2a_transducers[asked]);
        break;
    case 2:
        tell_state(&j2a_transducers[asked]);
        break;
    default:
        turn(&j2a_transducers[saved]);
    }
    return 0;
}
