/* What transducers do, by other means than the core's: values are numbers, queues are lists.
 * In: what drivers give, requests, and turns of the main loop, each with the time. Out: replies, sample SIFs and
 * calls of actuators that are due. */
#ifndef MODEL_H
#define MODEL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { MOST_BYTES = 255, MOST_CHANNELS = 5, MOST_SIZE = 12, TRANSDUCERS = 13 };

/* One transducer, as transds.def has it. form: 'i', 'u', 'f', 'd' of numbers, 's' of a structure. */
typedef struct {
    uint8_t id, channels, size;
    char form;
    uint8_t depth;
    bool is_sensor, has_trigger, has_watchdog;
    uint32_t period_us;
    uint16_t watchdog_ms;
    uint8_t decimation; /* 0 without */
    double threshold;   /* below 0 without */
    const char *topic;
    bool has_na, has_range, is_disabled;
    double na, low, high;
} described;
extern const described model_of[TRANSDUCERS];

/* A call of a driver: the value that a channel of an actuator is set to, or with `is_start` a trigger. */
typedef struct {
    uint8_t index, channel;
    bool is_start;
    uint8_t value[MOST_SIZE];
} model_call;

/* Ends what is kept without power, too. */
void model_reset(void);

/* Says that the clock of values, SET and TRIGGER now is so far ahead of the time in the other calls. */
void model_clock(uint64_t ahead_us);

/* Says that the device starts anew, with the settings that it kept without power. */
void model_restart(uint64_t now_us);
void model_sense(uint8_t index, uint8_t channel, const uint8_t *value, uint64_t now_us);

/* Returns the code, and leaves the payload of the reply. */
uint8_t model_request(const uint8_t *request, uint8_t length, uint8_t *reply, uint8_t *reply_length, uint64_t now_us);

/* Says that a request was executed. */
void model_hear(uint64_t now_us);

/* Does what is due before sample SIFs are. */
void model_turn(uint64_t now_us);

/* Returns whether a sensor sends a sample SIF now, and leaves its payload. */
bool model_is_due(uint8_t index, uint64_t now_us, uint8_t *payload, uint8_t *length);

/* Says that it did. */
void model_sent(uint8_t index, uint64_t now_us);

/* Called by the above, in the order in which the core calls drivers. */
void model_calls(const model_call *call);

#endif
