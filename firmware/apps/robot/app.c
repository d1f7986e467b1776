/* All sensors of a robot but cameras, on one chip: what they leave of its wire and of its time. The drivers are stand-ins
 * that measure at the top rates of the thesis' table 5.1; each value is one more than the one before. */
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

uint32_t app_turns(void) {
    return turn;
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

/* Each driver, and the ms between two measurements. */
static const struct {
    void (*measure)(void);
    uint16_t period_ms;
} drivers[] = {{bump, 1000}, {look_down, 1000}, {look_around, 20}, {listen, 40}, {locate, 200}, {turn_around, 20}};
enum { DRIVERS = sizeof drivers / sizeof drivers[0] };

void j2a_app_task(void) {
    static uint32_t due_ms[DRIVERS];
    const uint32_t now_ms = (uint32_t)(j2a_port_time_us() / 1000);
    uint8_t i;
    turn++;
    for (i = 0; i < DRIVERS; i++) {
        if (!measures) {
            due_ms[i] = now_ms;
        } else if (now_ms - due_ms[i] >= drivers[i].period_ms) {
            due_ms[i] += drivers[i].period_ms;
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
