/* All sensors of a robot but cameras, on one chip: what they leave of its wire and of its time. The drivers are stand-ins
 * that measure at the top rates of the thesis' tables 2.2 and 5.1; each value is one more than the one before. */
#include "j2a_functions.h"
#include "transds.h"

#define DRIVER(prefix, type) \
    static void (*prefix##_cb) J2A_VALUE_OF(type); \
    void prefix##_set_cb(void (*callback) J2A_VALUE_OF(type)) { \
        prefix##_cb = callback; \
    }
DRIVER(bumper, bool)
DRIVER(cliff, bool)
DRIVER(infrared, array(u8, 16))
DRIVER(ultrasonic, array(u16, 16))
DRIVER(gps, fix)
DRIVER(ahrs, motion)

static uint32_t turn;
static bool measures;

void app_turns(uint32_t *count, uint32_t *time) {
    *count = turn;
    *time = (uint32_t)j2a_port_time_us();
}

void app_measure(bool on) {
    measures = on;
}

static void bump(void) {
    static uint8_t at;
    bumper_cb(at % 16, (at & 16) == 0);
    at++;
}

static void look_down(void) {
    static uint8_t at;
    cliff_cb(at % 8, (at & 8) == 0);
    at++;
}

static void look_around(void) {
    static uint8_t near[16];
    uint8_t i;
    for (i = 0; i < 16; i++)
        near[i]++;
    infrared_cb(0, near);
}

static void listen(void) {
    static uint16_t far[16];
    uint8_t i;
    for (i = 0; i < 16; i++)
        far[i]++;
    ultrasonic_cb(0, far);
}

static void locate(void) {
    static fix here;
    here.latitude++;
    gps_cb(0, &here);
}

static void turn_around(void) {
    static motion now;
    now.rate[0]++;
    ahrs_cb(0, &now);
}

/* Each of the 16 bumpers and of the 8 cliff sensors, at one moment. */
void app_crash(void) {
    uint8_t i;
    for (i = 0; i < 16; i++)
        bump();
    for (i = 0; i < 8; i++)
        look_down();
}

/* Each driver, and the microseconds between two measurements. Each bumper and each cliff sensor has its turn in a second. */
static const struct {
    void (*measure)(void);
    uint32_t period_us;
} drivers[] = {{bump, 62500}, {look_down, 125000}, {look_around, 20000}, {listen, 40000}, {locate, 100000}, {turn_around, 20000}};
enum { DRIVERS = sizeof drivers / sizeof drivers[0] };

void j2a_app_task(void) {
    static uint32_t due_us[DRIVERS];
    const uint32_t now_us = (uint32_t)j2a_port_time_us();
    uint8_t i;
    turn++;
    for (i = 0; i < DRIVERS; i++) {
        if (!measures) {
            due_us[i] = now_us;
        } else if (now_us - due_us[i] >= drivers[i].period_us) {
            due_us[i] += drivers[i].period_us;
            drivers[i].measure();
        }
    }
    transds_process();
}

int main(int argc, char **argv) {
    j2a_port_init(argc, argv);
    transds_init();
    for (;;) {
        j2a_task();
        j2a_app_task();
        j2a_port_idle();
    }
}
