/* Settings of transducers that stay without power: into the port's memory flows what SAVE asks for, out of it, at the
 * start, what was saved last (J2A-TRANS-019, J2A-TRANS-028).
 * A transducer has two records: mark, CRC-32, and each of its settings as length, bytes and padding. They take turns,
 * so that one of them is whole at any time. The mark counts 1, 2, 3, 1 ..., so that of two the newer one is known; it is
 * made invalid before anything else of its record is written, and valid last.
 * Rules: the CRC covers the descriptors too, so settings of another firmware are never used. j2a_save_turn() begins to
 * write one byte at most, and a byte that is right already is not written. A memory that does not take a byte in time has
 * lost the record that is being written, and never the other one. */
#include "j2a_transds.h"

#if J2A_WITH_SAVE

#define LONGEST_US 9000000UL /* of a save: 10 s, less what a turn of the main loop takes */

#ifndef J2A_PORT_KEPT_BYTES
#error "J2A_WITH_SAVE=1 needs a port that keeps bytes without power: j2a_port_kept() in core/j2a_port.h"
#endif

enum { MARK, CHECK, SETTINGS = J2A_SAVED_HEADER }; /* in a record */
enum { NO_MARK = 0xFF, MARKS = 3, NONE = 0xFF };
enum { LONGEST = SETTINGS + 2 + 5 + 2 + 9 + 1 + J2A_TRANSD_MAX_TOPIC }; /* of a sensor, which has more than an actuator */

static uint32_t descriptors_crc;

/* The record that is being written. */
static uint16_t saving_at;  /* where it begins */
static uint8_t saving_id;
static uint8_t saving_next; /* byte to be written next; 0: the mark, invalid; behind the last one: the mark, valid */
static uint8_t saving_left; /* 0: nothing is being written; then saving_next is NONE if the last save failed */
static uint32_t saving_since_us;
static uint8_t record[LONGEST];

/* Bit by bit: a table would be longer than the rest of this file. */
static uint32_t crc_of(uint32_t crc, uint8_t byte) {
    uint8_t bit;
    crc ^= byte;
    for (bit = 0; bit < 8; bit++)
        crc = crc >> 1 ^ ((crc & 1) != 0 ? 0xEDB88320 : 0);
    return crc;
}

/* The bytes of a setting at most, 0 for what the transducer does not have. */
static uint8_t room_of(const j2a_transducer *t, uint8_t item) {
    switch (item) {
    case J2A_TRANSD_ENABLED:
        return t->sensor ? 1 : 0;
    case J2A_TRANSD_PERIOD:
        return t->sensor ? 4 : 0;
    case J2A_TRANSD_DECIMATION:
        return t->decimation ? 1 : 0;
    case J2A_TRANSD_THRESHOLD:
        return t->threshold && t->size <= 8 ? t->size : 0;
    case J2A_TRANSD_TOPIC:
        return t->topic ? J2A_TRANSD_MAX_TOPIC : 0;
    default: /* J2A_TRANSD_WATCHDOG */
        return t->watchdog ? 2 : 0;
    }
}

static uint8_t record_bytes(const j2a_transducer *t) {
    uint8_t bytes = SETTINGS;
    uint8_t item;
    for (item = J2A_TRANSD_ENABLED; item <= J2A_TRANSD_WATCHDOG; item++) {
        const uint8_t room = room_of(t, item);
        bytes = (uint8_t)(bytes + (room != 0 ? 1 + room : 0));
    }
    return bytes;
}

/* Where the records of a transducer begin. */
static uint16_t records_of(uint8_t id) {
    uint16_t at = 0;
    uint8_t index;
    for (index = 0; index < j2a_transducer_count; index++) {
        j2a_transducer t;
        j2a_flash_load(&t, &j2a_transducers[index], sizeof t);
        if (t.id == id)
            break;
        at = (uint16_t)(at + 2 * record_bytes(&t));
    }
    return at;
}

/* The CRC of a record, without that of it. bytes: null for one in the port's memory. */
static uint32_t check_of(const uint8_t *bytes, uint16_t at, uint8_t length) {
    uint32_t crc = descriptors_crc;
    uint8_t i;
    for (i = 0; i < length; i++)
        if (i < CHECK || i >= SETTINGS)
            crc = crc_of(crc, bytes ? bytes[i] : j2a_port_kept((uint16_t)(at + i)));
    return ~crc;
}

/* The mark of a record, 0 for one that is not whole. */
static uint8_t mark_of(uint16_t at, uint8_t length) {
    const uint8_t mark = j2a_port_kept(at);
    uint32_t crc;
    uint8_t i;
    if (mark == 0 || mark > MARKS)
        return 0;
    crc = check_of(0, at, length);
    for (i = CHECK; i < SETTINGS; i++, crc >>= 8)
        if (j2a_port_kept((uint16_t)(at + i)) != (uint8_t)crc)
            return 0;
    return mark;
}

/* Which of two records is the newer one that is whole, 0 or 1, else NONE. *mark: its mark, else 0. */
static uint8_t newer(uint16_t at, uint8_t length, uint8_t *mark) {
    const uint8_t first = mark_of(at, length);
    const uint8_t second = mark_of((uint16_t)(at + length), length);
    *mark = first;
    if (second != 0 && (first == 0 || second == first % MARKS + 1)) {
        *mark = second;
        return 1;
    }
    return first != 0 ? 0 : NONE;
}

/* Puts the settings of now into `record`; returns whether those at `at` are others. */
static bool gather(const j2a_transducer *t, uint16_t at) {
    uint8_t n = SETTINGS;
    bool differs = false;
    uint8_t item;
    uint8_t i;
    for (item = J2A_TRANSD_ENABLED; item <= J2A_TRANSD_WATCHDOG; item++) {
        const uint8_t room = room_of(t, item);
        if (room == 0)
            continue;
        record[n] = j2a_read_item(t, item, record + n + 1);
        for (i = record[n]; i < room; i++)
            record[n + 1 + i] = 0;
        n = (uint8_t)(n + 1 + room);
    }
    for (i = SETTINGS; i < n; i++)
        differs |= record[i] != j2a_port_kept((uint16_t)(at + i));
    return differs;
}

static uint32_t turn_us(void) {
    return (uint32_t)j2a_port_time_us();
}

uint8_t j2a_save(const j2a_transducer *t, const uint8_t *value, uint8_t length) {
    const uint8_t bytes = record_bytes(t);
    const uint16_t at = records_of(t->id);
    uint8_t mark;
    uint8_t kept;
    uint32_t crc;
    uint8_t i;
    if (length != 1)
        return J2A_TRANSD_BAD_LENGTH;
    if (value[0] != J2A_TRANSD_SAVED)
        return J2A_TRANSD_BAD_VALUE;
    if (saving_left != 0)
        return J2A_TRANSD_BUSY;
    saving_next = 0;
    kept = newer(at, bytes, &mark);
    if (!gather(t, (uint16_t)(at + (kept == 1 ? bytes : 0))) && kept != NONE)
        return 0;
    record[MARK] = (uint8_t)(mark % MARKS + 1);
    crc = check_of(record, 0, bytes);
    for (i = CHECK; i < SETTINGS; i++, crc >>= 8)
        record[i] = (uint8_t)crc;
    saving_at = (uint16_t)(at + (kept == 0 ? bytes : 0));
    saving_id = t->id;
    saving_since_us = turn_us();
    saving_left = (uint8_t)(bytes + 1);
    return 0;
}

uint8_t j2a_save_state(const j2a_transducer *t) {
    uint8_t mark;
    if (saving_id == t->id) {
        if (saving_left != 0)
            return J2A_TRANSD_SAVING;
        if (saving_next == NONE)
            return J2A_TRANSD_NOT_SAVED; /* what there is is not of the last write */
    }
    return newer(records_of(t->id), record_bytes(t), &mark) != NONE ? J2A_TRANSD_SAVED : J2A_TRANSD_NOT_SAVED;
}

void j2a_save_turn(void) {
    while (saving_left != 0) {
        const bool is_last = saving_left == 1;
        const uint8_t byte = saving_next == 0 ? NO_MARK : record[is_last ? MARK : saving_next];
        if (!j2a_port_keep((uint16_t)(saving_at + (is_last ? MARK : saving_next)), byte)) {
            if (turn_us() - saving_since_us >= LONGEST_US) {
                saving_left = 0;
                saving_next = NONE;
            }
            break;
        }
        saving_next++;
        saving_left--;
    }
}

static void restore(const j2a_transducer *t, uint16_t at) {
    uint8_t item;
    for (item = J2A_TRANSD_ENABLED; item <= J2A_TRANSD_WATCHDOG; item++) {
        const uint8_t room = room_of(t, item);
        uint8_t value[J2A_TRANSD_MAX_TOPIC];
        const uint8_t length = room != 0 ? j2a_port_kept(at++) : 0;
        uint8_t i;
        for (i = 0; i < room; i++, at++)
            value[i] = j2a_port_kept(at);
        if (length != 0 && length <= room)
            (void)j2a_write_item(t, item, value, length);
    }
}

void j2a_save_start(void) {
    uint16_t at = 0;
    uint8_t index;
    const char *text;
    uint8_t c;
    descriptors_crc = 0xFFFFFFFF;
    for (text = j2a_descriptors; (c = j2a_flash_u8(text)) != 0; text++)
        descriptors_crc = crc_of(descriptors_crc, c);
    for (index = 0; index < j2a_transducer_count; index++) {
        j2a_transducer t;
        uint8_t bytes;
        uint8_t mark;
        uint8_t kept;
        j2a_flash_load(&t, &j2a_transducers[index], sizeof t);
        bytes = record_bytes(&t);
        kept = newer(at, bytes, &mark);
        if (kept != NONE)
            restore(&t, (uint16_t)(at + (kept == 1 ? bytes : 0) + SETTINGS));
        at = (uint16_t)(at + 2 * bytes);
    }
}

#endif
