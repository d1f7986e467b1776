/* Sensors and servos. In: the callbacks of the drivers in drivers/avr, requests of the host. Out: replies, SIFs
 * with samples (see transducers.h and transds.def), pulses for servos, a lamp.
 * A wrong channel or transducer returns J2A_RET_FAILED. */
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

uint64_t app_getTime(void) {
    return j2a_port_time_us();
}

void app_getEncoder(uint8_t channel, uint64_t *time, int16_t *count, uint16_t *errors) {
    if (channel >= QUAD_COUNT) {
        j2a_fail(J2A_RET_FAILED);
        return;
    }
    sample_take(&quads[channel]);
    *time = quads[channel].time_us;
    *count = (int16_t)quads[channel].taken;
    *errors = quad_errors(channel);
}

void app_setEncoder(uint8_t channel, int16_t count) {
    if (channel >= QUAD_COUNT) {
        j2a_fail(J2A_RET_FAILED);
        return;
    }
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { /* no step may come in between */
        quad_set(channel, count);
        sample_put(&quads[channel], (uint16_t)count);
    }
}

#if SENSORS_ADC
/* Measures all inputs anew, which takes 0.5 ms. Returns the sample of this one, null if there is none. */
static const sample *measure(uint8_t channel, uint8_t channels) {
    if (channel >= channels) {
        j2a_fail(J2A_RET_FAILED);
        return 0;
    }
    while (adc_busy()) { /* one that has begun before */
    }
    adc_start();
    while (adc_busy()) {
    }
    sample_take(&analogs[channel]);
    return &analogs[channel];
}

void app_getAdc(uint8_t channel, uint64_t *time, uint16_t *value) {
    const sample *const s = measure(channel, adc_channels);
    if (s != 0) {
        *time = s->time_us;
        *value = s->taken;
    }
}

void app_getDistance(uint8_t channel, uint64_t *time, uint16_t *distance) {
    const sample *const s = measure(channel, dist_ir_channels);
    if (s != 0) {
        *time = s->time_us;
        *distance = sharp_mm(s->taken);
    }
}
#endif

/* Takes i8 deflection -100..100, and u8 channel, which is 0 when it is left out. A signature has no optional
 * parameters, so this function gets its payload as it is. */
uint8_t sensors_set_servo(uint8_t *const length, uint8_t **const payload) {
    const uint8_t channel = *length == 2 ? (*payload)[1] : 0;
    const bool right = *length >= 1 && *length <= 2 && channel < SERVO_COUNT;
    *length = 0;
    if (!right)
        return J2A_RET_FAILED;
    servo_set(channel, (int8_t)(*payload)[0]);
    return 0;
}

void app_setPeriod(uint8_t id, uint16_t period) {
    static void (*const on_period[])(void) = {
        on_quad_period,
#if SENSORS_ADC
        on_dist_ir_period, on_adc_period
#endif
    };
    if (id >= TRANSDUCERS) {
        j2a_fail(J2A_RET_FAILED);
        return;
    }
    timer_start(id, period, on_period[id]);
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        due &= (uint8_t)~(1 << id);
    }
}

void app_setBlink(uint16_t period) {
    timer_start(TIMER_LAMP, period, on_lamp);
}

uint16_t app_overruns(void) {
    return j2a_port_overruns();
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
