/* The main loop's share: the log, and the alarm of each link. */
#include "flow.h"

#define SAMPLE_US 100000u

static struct {
    bool armed;
    uint32_t at;
} alarms[J2A_LINKS];

static uint16_t samples[LOG_SAMPLES];
static uint16_t sample_count, oldest;

void alarm_at(uint32_t pulses) {
    alarms[j2a_link].at = pulses;
    alarms[j2a_link].armed = true;
}

uint16_t log_copy(uint8_t *bytes) {
    uint16_t i;
    for (i = 0; i < sample_count; i++) {
        const uint16_t sample = samples[(oldest + i) % LOG_SAMPLES];
        *bytes++ = (uint8_t)sample;
        *bytes++ = (uint8_t)(sample >> 8);
    }
    return (uint16_t)(2 * sample_count);
}

static void log_sample(void) {
    static uint32_t last_us, last_pulses;
    const uint32_t now = pulses_total();
    if ((uint32_t)j2a_port_time_us() - last_us < SAMPLE_US)
        return;
    last_us += SAMPLE_US;
    if (sample_count < LOG_SAMPLES)
        sample_count++;
    else
        oldest = (uint16_t)((oldest + 1) % LOG_SAMPLES);
    samples[(oldest + sample_count - 1) % LOG_SAMPLES] = (uint16_t)(now - last_pulses);
    last_pulses = now;
}

static void send_alarm(void) {
    const uint32_t now = pulses_total();
    uint8_t payload[4];
    if (!alarms[j2a_link].armed || now < alarms[j2a_link].at)
        return;
    alarms[j2a_link].armed = false;
    j2a_put_u32(payload, now);
    j2a_send_sif(SIF_ALARM, sizeof payload, payload);
    j2a_debug("alarm\n");
}

void j2a_app_task(void) {
    static bool started;
    if (!started) {
        started = true;
        pulses_start();
    }
    log_sample();
#if J2A_LINKS > 1
    for (j2a_link = J2A_LINKS - 1; j2a_link != 0; j2a_link--) /* and at last 0, as it was */
        send_alarm();
#endif
    send_alarm();
}
