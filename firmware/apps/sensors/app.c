/* Sensors and servos. In: the callbacks of the drivers in drivers/avr, requests of the host. Out: replies, SIFs
 * with samples (see transducers.h and transds.def), pulses for servos, a lamp.
 * Numbers are little-endian; a wrong length, channel or transducer returns J2A_RET_FAILED. */
#include <util/atomic.h>

#include "adc.h"
#include "j2a_functions.h"
#include "pins.h"
#include "quad.h"
#include "servo.h"
#include "sharp.h"
#include "timer.h"
#include "transducers.h"

#define TRANSDUCERS (SENSORS_ADC ? 3 : 1)
enum { TIMER_LAMP = TRANSDUCERS };

static sample quads[QUAD_COUNT];
#if SENSORS_ADC
static sample analogs[ADC_COUNT];
#endif
static volatile uint8_t due; /* a bit for each transducer whose period is over */

/* ------------------------------------------------------------ what interrupts call ---------- */

#ifndef QUAD_CALLBACK
static
#endif
void on_quad(uint8_t channel, int16_t value) {
    sample_put(&quads[channel], (uint16_t)value);
}

static void on_quad_period(void) {
    due |= 1 << quad_id;
}

static void on_lamp(void) {
    LAMP_PIN = _BV(LAMP_BIT); /* writing 1 there toggles */
}

#if SENSORS_ADC
static void on_adc(uint8_t channel, uint16_t value) {
    sample_put(&analogs[channel], value);
}

static void on_dist_ir_period(void) {
    due |= 1 << dist_ir_id;
    adc_start();
}

static void on_adc_period(void) {
    due |= 1 << adc_id;
    adc_start();
}
#endif

/* ------------------------------------------------------------ functions --------------------- */

static uint16_t get_u16(const uint8_t *bytes) {
    return (uint16_t)(bytes[0] | (uint16_t)bytes[1] << 8);
}

static uint8_t failed(uint8_t *length) {
    *length = 0;
    return J2A_RET_FAILED;
}

/* Replies u64: microseconds since the start. */
uint8_t sensors_get_time(uint8_t *const length, uint8_t **const payload) {
    const uint64_t now_us = j2a_port_time_us();
    j2a_put_u32(*payload, (uint32_t)now_us);
    j2a_put_u32(*payload + 4, (uint32_t)(now_us >> 32));
    *length = 8;
    return 0;
}

/* Takes u8 channel, replies u64 microseconds (of the last step, 0: none yet), i16 count, u16 errors. */
uint8_t sensors_get_encoder(uint8_t *const length, uint8_t **const payload) {
    const uint8_t channel = (*payload)[0];
    uint16_t errors;
    if (*length != 1 || channel >= QUAD_COUNT)
        return failed(length);
    sample_take(&quads[channel]);
    sample_write(&quads[channel], quads[channel].taken, *payload);
    errors = quad_errors(channel);
    (*payload)[SAMPLE_BYTES] = (uint8_t)errors;
    (*payload)[SAMPLE_BYTES + 1] = (uint8_t)(errors >> 8);
    *length = SAMPLE_BYTES + 2;
    return 0;
}

/* Takes u8 channel, i16 count, which is a sample like those of steps. */
uint8_t sensors_set_encoder(uint8_t *const length, uint8_t **const payload) {
    const uint8_t channel = (*payload)[0];
    if (*length != 3 || channel >= QUAD_COUNT)
        return failed(length);
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { /* no step may come in between */
        quad_set(channel, (int16_t)get_u16(*payload + 1));
        sample_put(&quads[channel], get_u16(*payload + 1));
    }
    *length = 0;
    return 0;
}

#if SENSORS_ADC
/* Measures all inputs anew, which takes 0.5 ms. */
static void scan(void) {
    while (adc_busy()) { /* one that has begun before */
    }
    adc_start();
    while (adc_busy()) {
    }
}

static uint8_t reply_analog(uint8_t *const length, uint8_t *const payload, uint8_t channels, bool is_distance) {
    const uint8_t channel = payload[0];
    sample *s;
    if (*length != 1 || channel >= channels)
        return failed(length);
    scan();
    s = &analogs[channel];
    sample_take(s);
    sample_write(s, is_distance ? sharp_mm(s->taken) : s->taken, payload);
    *length = SAMPLE_BYTES;
    return 0;
}

/* Takes u8 channel, replies u64 microseconds, u16 counts. */
uint8_t sensors_get_adc(uint8_t *const length, uint8_t **const payload) {
    return reply_analog(length, *payload, adc_channels, false);
}

/* Takes u8 channel, replies u64 microseconds, u16 millimetres; 0: out of range. */
uint8_t sensors_get_distance(uint8_t *const length, uint8_t **const payload) {
    return reply_analog(length, *payload, dist_ir_channels, true);
}
#endif

/* Takes i8 deflection -100..100, and u8 channel, which is 0 when it is left out. */
uint8_t sensors_set_servo(uint8_t *const length, uint8_t **const payload) {
    const uint8_t channel = *length == 2 ? (*payload)[1] : 0;
    if (*length < 1 || *length > 2 || channel >= SERVO_COUNT)
        return failed(length);
    servo_set(channel, (int8_t)(*payload)[0]);
    *length = 0;
    return 0;
}

/* Takes u8 transducer, u16 milliseconds between its SIFs at least; 0 stops them. */
uint8_t sensors_set_period(uint8_t *const length, uint8_t **const payload) {
    static void (*const on_period[])(void) = {
        on_quad_period,
#if SENSORS_ADC
        on_dist_ir_period, on_adc_period
#endif
    };
    const uint8_t id = (*payload)[0];
    if (*length != 3 || id >= TRANSDUCERS)
        return failed(length);
    timer_start(id, get_u16(*payload + 1), on_period[id]);
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        due &= (uint8_t)~(1 << id);
    }
    *length = 0;
    return 0;
}

/* Takes u16 milliseconds after which the lamp changes; 0 leaves it as it is. */
uint8_t sensors_set_blink(uint8_t *const length, uint8_t **const payload) {
    if (*length != 2)
        return failed(length);
    timer_start(TIMER_LAMP, get_u16(*payload), on_lamp);
    *length = 0;
    return 0;
}

/* Replies u16: receive overruns since the start. */
uint8_t sensors_overruns(uint8_t *const length, uint8_t **const payload) {
    const uint16_t overruns = j2a_port_overruns();
    (*payload)[0] = (uint8_t)overruns;
    (*payload)[1] = (uint8_t)(overruns >> 8);
    *length = 2;
    return 0;
}

/* ------------------------------------------------------------ the main loop ----------------- */

#if J2A_WITH_SIF
static uint16_t raw(uint16_t value) {
    return value;
}

/* Sends the newest samples of a transducer when its period is over; returns whether it did. */
static bool report(uint8_t id, sample *samples, uint8_t channels, uint16_t (*convert)(uint16_t)) {
    uint8_t payload[ADC_COUNT * SAMPLE_BYTES];
    bool changed = false;
    uint8_t i;
    if (!(due & 1 << id))
        return false;
    for (i = 0; i < channels; i++)
        changed |= sample_changed(&samples[i]);
    if (!changed) /* then with the next change */
        return false;
    for (i = 0; i < channels; i++)
        sample_write(&samples[i], convert(samples[i].taken), payload + i * SAMPLE_BYTES);
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        due &= (uint8_t)~(1 << id);
    }
    j2a_send_sif(id, (uint8_t)(channels * SAMPLE_BYTES), payload);
    return true;
}

/* At most one SIF in a turn of the main loop, because meanwhile received bytes wait in the ring. */
static void report_next(void) {
    if (report(quad_id, quads, quad_channels, raw))
        return;
#if SENSORS_ADC
    if (!adc_busy() && !report(dist_ir_id, analogs, dist_ir_channels, sharp_mm))
        report(adc_id, analogs, adc_channels, raw);
#endif
}
#endif

void j2a_app_task(void) {
    static uint8_t last;
    const uint8_t now = (uint8_t)(j2a_port_ticks() >> 12); /* changes each 16 ms */
    uint8_t i;
    if (now != last) {
        last = now;
        for (i = 0; i < QUAD_COUNT; i++)
            sample_watch(&quads[i]);
#if SENSORS_ADC
        for (i = 0; i < ADC_COUNT; i++)
            sample_watch(&analogs[i]);
#endif
    }
#if J2A_WITH_SIF
    report_next();
#endif
}

int main(int argc, char **argv) {
    j2a_selftest();
    j2a_port_init(argc, argv);
    LAMP_DDR |= _BV(LAMP_BIT);
#ifndef QUAD_CALLBACK
    quad_set_cb(on_quad);
#endif
    quad_init();
    servo_init();
    timer_init();
#if SENSORS_ADC
    adc_set_cb(on_adc);
    adc_init();
#endif
    for (;;) {
        j2a_task();
        j2a_app_task();
        j2a_port_idle();
    }
}
