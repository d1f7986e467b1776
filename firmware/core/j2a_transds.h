/* What the table of transducers, which j2a_transds_table.c makes of transds.def, and the engine in ext/j2a_transducers.c
 * share. */
#ifndef J2A_TRANSDS_H
#define J2A_TRANSDS_H

#include "j2a_internal.h"

/* The bytes of a channel's time, and of what stands before the values of a sensor with a queue. */
enum { J2A_TIME_BYTES = 8, J2A_LOST_BYTES = 2 };

/* The most bytes of a sample SIF. */
#if J2A_PORT_SHARES_ROOM
#define J2A_SAMPLE_ROOM J2A_ROOM
#else
#define J2A_SAMPLE_ROOM J2A_MAX_PAYLOAD
#endif

/* Raw values that a transds.def gives. */
enum { J2A_RAW_NA, J2A_RAW_THRESHOLD, J2A_RAW_LOW, J2A_RAW_HIGH };

/* A reference time before that of the start, modulo 2^64: the first sample SIF is due at once, and late by any PERIOD. */
#define J2A_LONG_AGO (3ULL << 62)

/* What is kept of each sensor, in RAM. The driver's context writes what is volatile but `tail`. What j2a_keep() writes
 * comes first, because an AVR reaches what is farther from the start only by more cycles. */
typedef struct {
    volatile uint8_t head; /* entries that were put into the queue; without one odd while a value is written */
    volatile bool is_fresh; /* without a queue: a value was taken since the last sample SIF */
    uint64_t reference_us; /* PERIOD after it the next sample SIF is due (J2A-TRANS-011) */
    uint32_t period_us;
    volatile bool is_enabled;
} j2a_sensor;

typedef struct {
    volatile uint8_t tail; /* entries that were taken out of the queue */
    uint8_t put_at;
    uint8_t take_at;
    volatile uint16_t full; /* values that found no room */
    uint16_t dropped;       /* values that waited when the sensor was disabled */
} j2a_queue;

/* What waits for its time. */
typedef struct {
    uint64_t due_us;
    bool waits;
} j2a_due;

typedef struct {
    uint16_t limit_ms; /* 0: never */
    bool is_safe;      /* since the last request */
} j2a_watchdog;

/* One transducer, in flash. Pointers to what it does not have are null. A slot of a channel is its time and its value,
 * one of a queue the channel before. The time is that of j2a_stamp() where drivers write it. What j2a_sense() needs comes first, up to `topic`. */
typedef struct {
    uint8_t id;
    uint8_t channels;
    uint8_t size;                 /* of a value, in bytes */
    uint8_t depth;                /* of the queue, 0 without one */
    j2a_sensor *sensor;
    j2a_queue *queue;
    volatile uint8_t *slots;      /* of the queue, else of each channel */
    uint8_t *decimation;          /* the setting, then for each channel the values since one was taken */
    uint8_t *threshold;           /* which of the two that follow is the setting */
    uint8_t *last;                /* of each channel of a queue with threshold: whether there is one, the last value */
    char *topic;                  /* NUL behind it */
    j2a_due *trigger;
    j2a_due *waiting;             /* of each channel of an actuator */
    uint8_t *values;              /* for which they wait */
    j2a_watchdog *watchdog;
    void (*start)(void);          /* sensor: the driver's trigger */
    void (*set)(uint8_t channel, const uint8_t *value);
    bool (*raw)(uint8_t which, uint8_t *value);
    int8_t (*compare)(const uint8_t *a, const uint8_t *b, uint8_t size);
    bool (*is_near)(const uint8_t *a, const uint8_t *b, const uint8_t *limit, uint8_t size);
    void (*tidy)(uint8_t *value); /* makes each bool of a value from the host 0 or 1; null without a bool */
} j2a_transducer;

extern const j2a_transducer j2a_transducers[];
extern const uint8_t j2a_transducer_count;
extern const char j2a_descriptors[]; /* in flash */

#if J2A_WITH_TRANSDUCERS
/* Writes the time of a value, J2A_TIME_BYTES bytes that are not all 0: as the port notes it cheaply, or microseconds. */
#if J2A_PORT_STAMP && !J2A_WITH_SYNC
#define j2a_stamp j2a_port_stamp
#else
void j2a_stamp(volatile uint8_t *to);
#endif

/* Puts a value into the slot of its channel. A sensor with nothing but newest values has this in its callback, because an
 * encoder's interrupt has no time to look up what sensor it is. */
J2A_ALWAYS_INLINE void j2a_keep(j2a_sensor *sensor, volatile uint8_t *slot, const uint8_t *value, uint8_t size) {
    uint8_t i;
    sensor->head++;
    j2a_stamp(slot);
    for (i = 0; i < size; i++)
        slot[J2A_TIME_BYTES + i] = value[i];
    sensor->head++;
    sensor->is_fresh = true;
}
#endif

/* Called by the callback of a driver whose sensor has a queue, a decimation or a threshold. index: of the transducer.
 * value: its bytes on the wire. */
void j2a_sense(uint8_t index, uint8_t channel, const uint8_t *value);

/* The body of transds_process(). payload: room for the longest sample SIF; null: none can be sent now. */
void j2a_turn(uint8_t *payload);

/* The part J2A_WITH_SAVE, in ext/j2a_save.c. */
#if J2A_WITH_SAVE
enum { J2A_SAVED_HEADER = 5 }; /* bytes of a record before the settings */

/* A read and a write of an item, as by a2jTransd. Return 0 bytes for one that is not there, and the code. */
uint8_t j2a_read_item(const j2a_transducer *t, uint8_t item, uint8_t *payload);
uint8_t j2a_write_item(const j2a_transducer *t, uint8_t item, const uint8_t *value, uint8_t length);

/* Brings the settings back that were saved. Called once, at the start. */
void j2a_save_start(void);

/* Goes on with what is being saved. */
void j2a_save_turn(void);

/* A write of SAVE, which returns the code, and a read. */
uint8_t j2a_save(const j2a_transducer *t, const uint8_t *value, uint8_t length);
uint8_t j2a_save_state(const j2a_transducer *t);
#endif

/* Compare two values: less than 0, 0, or more, and 2 where one is not a number. */
int8_t j2a_compare_unsigned(const uint8_t *a, const uint8_t *b, uint8_t size);
int8_t j2a_compare_signed(const uint8_t *a, const uint8_t *b, uint8_t size);
int8_t j2a_compare_f32(const uint8_t *a, const uint8_t *b, uint8_t size);
int8_t j2a_compare_f64(const uint8_t *a, const uint8_t *b, uint8_t size);

/* Return whether two values differ by less than a limit. */
bool j2a_near_unsigned(const uint8_t *a, const uint8_t *b, const uint8_t *limit, uint8_t size);
bool j2a_near_signed(const uint8_t *a, const uint8_t *b, const uint8_t *limit, uint8_t size);
bool j2a_near_f32(const uint8_t *a, const uint8_t *b, const uint8_t *limit, uint8_t size);
bool j2a_near_f64(const uint8_t *a, const uint8_t *b, const uint8_t *limit, uint8_t size);

#endif
