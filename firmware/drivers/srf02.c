/* See srf02.h. Registers: 0 takes commands, 2 and 3 hold the range, the higher byte first. */
#include "srf02.h"

#include "triggered.h"
#include "twi.h"
#include "wait.h"

enum { COMMAND, RANGE = 2, MEASURE_CM = 0x51 };
enum { TELLING, MEASURING, READING };

static void (*callback)(uint8_t channel, uint32_t cm);
static uint8_t phase;
static uint8_t channel;
static bool is_asked;     /* by srf02_trigger() */
static bool is_under_way; /* the transfer of this channel */
static wait_t begun;      /* it, or the measurement */
static uint8_t bytes[2];
static uint16_t found[SRF02_COUNT]; /* whether it measures, then centimetres; 0 for none */

void srf02_set_cb(void (*new_value)(uint8_t channel, uint32_t cm)) {
    callback = new_value;
}

void srf02_init(void) {
    twi_init();
}

static void begin(void) {
    bytes[0] = phase == TELLING ? COMMAND : RANGE;
    bytes[1] = MEASURE_CM;
    if (phase == TELLING)
        twi_transfer((uint8_t)(SRF02_ADDRESS + channel), bytes, 2, 0);
    else
        twi_transfer((uint8_t)(SRF02_ADDRESS + channel), bytes, 1, 2);
    wait_begin(&begun);
    is_under_way = true;
}

/* All at once, so that they make one sample. */
static void report(void) {
    uint8_t i;
    for (i = 0; i < SRF02_COUNT; i++)
        if (callback)
            callback(i, found[i] != 0 ? found[i] : SRF02_NA);
}

void srf02_task(void) {
    uint8_t state;
    if (phase == MEASURING) {
        if (!wait_is_over(&begun, SRF02_MEASURES_MS))
            return;
        phase = READING;
    }
    if (!is_under_way) {
        if (IS_TRIGGERED(srf02) && phase == TELLING && channel == 0) {
            if (!is_asked)
                return;
            is_asked = false;
        }
        begin();
        return;
    }
    state = twi_state();
    if (state == TWI_BUSY) {
        if (!wait_is_over(&begun, SRF02_LIMIT_MS))
            return;
        twi_stop();
    }
    is_under_way = false;
    if (state != TWI_DONE)
        found[channel] = 0;
    else if (phase == TELLING)
        found[channel] = 1;
    else if (found[channel] != 0) /* else it has the distance of before */
        found[channel] = (uint16_t)((unsigned)bytes[0] << 8 | bytes[1]);
    if (++channel < SRF02_COUNT)
        return;
    channel = 0;
    if (phase == TELLING) {
        wait_begin(&begun);
        phase = MEASURING;
    } else {
        report();
        phase = TELLING;
    }
}

void srf02_trigger(void) {
    is_asked = true;
    srf02_task();
}
