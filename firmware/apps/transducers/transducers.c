/* Transducers for the conformance suite: drivers that report what the function `stimulus` is told to, and
 * actuators that only take. */
#include "transds.h"

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
#if TRANSDUCERS_NUMBERS
DRIVER(count32, u32)
DRIVER(count64, u64)
DRIVER(place64, i64)
DRIVER(exact, f64)
DRIVER(small, i8)
DRIVER(place16, i16)
DRIVER(count8, u8)
DRIVER(flag, bool)
DRIVER(state, mood)
DRIVER(turn, phase)
DRIVER(event, code)
#endif

/* Each measurement is one more than the one before. */
void imu_trigger(void) {
    static int16_t count;
    motion value = {{0}, {0}, {0}};
    value.rate[0] = ++count;
    imu_cb(0, &value);
}

#if TRANSDUCERS_NUMBERS
/* Both channels, each time the other way round. */
void flag_trigger(void) {
    static bool is_set;
    is_set = !is_set;
    flag_cb(0, is_set);
    flag_cb(1, !is_set);
}
#endif

#define TAKER(prefix, type) \
    void prefix##_set(uint8_t channel, type value) { \
        (void)channel; \
        (void)value; \
    }
TAKER(servo, int8_t)
TAKER(motor, float)
TAKER(pose, const motion *)
TAKER(lights, uint16_t)
TAKER(valve, float)
#if TRANSDUCERS_NUMBERS
TAKER(far64, int64_t)
TAKER(mask64, uint64_t)
TAKER(stock, uint32_t)
TAKER(fine, double)
TAKER(shift16, int16_t)
TAKER(span32, int32_t)
TAKER(dial8, uint8_t)
TAKER(gate, bool)
TAKER(gear, phase)
TAKER(lamp, mood)
#endif

/* Has the driver of a sensor report a value; returns how many bytes the value has, 0 without such a sensor. A channel
 * that is null: nothing is reported. */
static uint8_t report(uint8_t id, const uint8_t *channel, const uint8_t *value) {
    motion moved;
#define REPORT(number, size, call) \
    case number: \
        if (channel) \
            call; \
        return size
    switch (id) {
        REPORT(0, 2, plain_cb(*channel, j2a_get_i16(value)));
        REPORT(1, 2, queued_cb(*channel, j2a_get_u16(value)));
        REPORT(2, 4, tuned_cb(*channel, j2a_get_i32(value)));
        REPORT(4, 4, level_cb(*channel, j2a_get_f32(value)));
        REPORT(5, 1, slow_cb(*channel, *value));
        REPORT(254, 2, wide_cb(*channel, j2a_get_u16(value)));
#if TRANSDUCERS_NUMBERS
        REPORT(20, 4, count32_cb(*channel, j2a_get_u32(value)));
        REPORT(21, 8, count64_cb(*channel, j2a_get_u64(value)));
        REPORT(22, 8, place64_cb(*channel, j2a_get_i64(value)));
        REPORT(23, 8, exact_cb(*channel, j2a_get_f64(value)));
        REPORT(24, 1, small_cb(*channel, (int8_t)*value));
        REPORT(40, 2, place16_cb(*channel, j2a_get_i16(value)));
        REPORT(41, 1, count8_cb(*channel, *value));
        REPORT(25, 1, flag_cb(*channel, *value != 0));
        REPORT(26, 1, state_cb(*channel, *value));
        REPORT(27, 2, turn_cb(*channel, j2a_get_i16(value)));
        REPORT(28, 4, event_cb(*channel, j2a_get_u32(value)));
#endif
    case 3:
        if (channel) {
            j2a_take_motion(&moved, value);
            imu_cb(*channel, &moved);
        }
        return 18;
    default:
        return 0;
    }
}

/* Takes an id, and then values, each with its channel before; the driver of the sensor reports them at once. */
uint8_t transducers_stimulus(uint8_t *const length, uint8_t **const payload) {
    const uint8_t *at = *payload;
    const uint8_t *const end = at + *length;
    const uint8_t id = *at++;
    const uint8_t size = at > end ? 0 : report(id, 0, 0);
    *length = 0;
    if (size == 0)
        return J2A_RET_FAILED;
    for (; end - at > size; at += 1 + size)
        (void)report(id, at, at + 1);
    return at == end ? 0 : J2A_RET_FAILED;
}

#if TRANSDUCERS_NUMBERS
/* Returns the lowest byte of the offset, whatever else it is told. */
uint8_t transducers_ret_many(bool *is_last, bool is_write, uint32_t *const offset, uint8_t *const length,
                             uint8_t **const data) {
    (void)is_last;
    (void)is_write;
    (void)data;
    *length = 0;
    return (uint8_t)*offset;
}

void app_echoNote(uint8_t first, const char *note, uint8_t note_length, uint8_t *first_out, char **note_out,
                  uint8_t *note_out_length) {
    *first_out = first;
    *note_out = (char *)note;
    *note_out_length = note_length;
}

void app_echoBlob(const uint8_t *blob, uint8_t blob_length, uint8_t **blob_out, uint8_t *blob_out_length) {
    *blob_out = (uint8_t *)blob;
    *blob_out_length = blob_length;
}
#endif

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
