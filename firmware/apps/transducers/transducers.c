/* Transducers for the conformance suite: drivers that report what the function `stimulus` is told to, and
 * actuators that only take. */
#include "transds.h"

/* The id of the last sensor. */
enum { WIDE = 254 };

#define DRIVER(prefix, type) \
    static void (*prefix##_cb) J2A_VALUE_OF(type); \
    void prefix##_set_cb(void (*callback) J2A_VALUE_OF(type)) { \
        prefix##_cb = callback; \
    }
DRIVER(plain, i16)
DRIVER(queued, u16)
DRIVER(tuned, i32)
DRIVER(imu, motion)
DRIVER(level, f32)
DRIVER(slow, u8)
DRIVER(wide, u16)

/* Each measurement is one more than the one before. */
void imu_trigger(void) {
    static int16_t count;
    motion value = {{0}, {0}, {0}};
    value.rate[0] = ++count;
    imu_cb(0, &value);
}

void servo_set(uint8_t channel, int8_t value) {
    (void)channel;
    (void)value;
}

void motor_set(uint8_t channel, float value) {
    (void)channel;
    (void)value;
}

void pose_set(uint8_t channel, const motion *value) {
    (void)channel;
    (void)value;
}

void lights_set(uint8_t channel, uint16_t value) {
    (void)channel;
    (void)value;
}

void valve_set(uint8_t channel, float value) {
    (void)channel;
    (void)value;
}

/* Takes an id, and then values, each with its channel before; the driver of the sensor reports them at once. */
uint8_t transducers_stimulus(uint8_t *const length, uint8_t **const payload) {
    const uint8_t *at = *payload;
    const uint8_t *const end = at + *length;
    const uint8_t id = *at++;
    static const uint8_t sizes[] = {2, 2, 4, 18, 4, 1};
    const uint8_t size = id < sizeof sizes ? sizes[id] : sizeof(uint16_t);
    *length = 0;
    if (at > end || (id >= sizeof sizes && id != WIDE))
        return J2A_RET_FAILED;
    for (; end - at > size; at += 1 + size) {
        motion value;
        if (id == 0)
            plain_cb(at[0], j2a_get_i16(at + 1));
        else if (id == 1)
            queued_cb(at[0], j2a_get_u16(at + 1));
        else if (id == 2)
            tuned_cb(at[0], j2a_get_i32(at + 1));
        else if (id == 3) {
            j2a_take_motion(&value, at + 1);
            imu_cb(at[0], &value);
        } else if (id == 4)
            level_cb(at[0], j2a_get_f32(at + 1));
        else if (id == WIDE)
            wide_cb(at[0], j2a_get_u16(at + 1));
        else
            slow_cb(at[0], at[1]);
    }
    return at == end ? 0 : J2A_RET_FAILED;
}

int main(int argc, char **argv) {
    j2a_selftest();
    j2a_port_init(argc, argv);
    transds_init();
    for (;;) {
        j2a_task();
        j2a_app_task();
        transds_process();
        j2a_port_idle();
    }
}
