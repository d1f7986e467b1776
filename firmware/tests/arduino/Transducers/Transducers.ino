/* One transducer of each sort, for the conformance suite, as apps/transducers has them: what the function stimulus
 * gives, their drivers report. */
#define J2A_TRANSDUCERS \
  J2A_STRUCT(motion, (array(i16, 3), rate, mdeg/s), (array(i16, 3), acceleration, mg), (array(i16, 3), field, uT)) \
  SENSOR(plain, 0, plain, TEST-1, 2, int16_t, -1) \
  SENSOR_EX(queued, 1, queued, TEST-2, 3, u16, none, (unit, mV), (queue, 4), "Keeps four values.") \
  SENSOR_EX(tuned, 2, tuned, TEST-3, 2, int32_t, 0x7FFFFFFF, (unit, mm), (scale, 0.5), (offset, -10), \
  (range, -1000, 100000), (accuracy, 2.5), (period, 0), (decimation, 1), (threshold, 0), \
  (topic, test/tuned), (color, blue), "Has each setting, and a key of its own.") \
  SENSOR_EX(imu, 3, imu, TEST-4, 1, motion, none, (trigger), "Nine values at once.") \
  SENSOR_EX(level, 4, level, TEST-5, 1, float, nan, (threshold, 0.5), (queue, 3), (enabled, 0), "Begins disabled.") \
  SENSOR_EX(slow, 5, slow, TEST-6, 1, u8, 255, (period, 50000), (decimation, 3), "At most 20 times a second.") \
  SENSOR_EX(wide, 254, wide, TEST-10, 12, u16, 65535, (decimation, 1), (threshold, 0), "Has many channels.") \
  ACTUATOR(servo, 10, servo, TEST-7, 2, int8_t, 5, (unit, %), (range, -100, 100), (watchdog, 0), (topic, servo), \
  "Refuses what is out of range.") \
  ACTUATOR(motor, 11, motor, TEST-8, 1, f32, none, "Takes each value.") \
  ACTUATOR(pose, 12, pose, TEST-9, 1, motion, none, (watchdog, 0), "A structure.") \
  ACTUATOR(lights, 13, lights, TEST-11, 5, u16, 40000, (range, 100, 60000), (watchdog, 0), "Has many channels.") \
  ACTUATOR(valve, 14, valve, TEST-12, 1, f32, none, (range, -1.5, 1.5), "Numbers with a range.")
#include <J2A.h>

J2A_SENSE(plain);
J2A_SENSE(queued);
J2A_SENSE(tuned);
J2A_SENSE(imu);
J2A_SENSE(level);
J2A_SENSE(slow);
J2A_SENSE(wide);

/* Each measurement is one more than the one before. */
void imu_trigger() {
  static int16_t count;
  const motion value = {{++count, 0, 0}, {0, 0, 0}, {0, 0, 0}};
  imu_sense(0, &value);
}

void servo_set(uint8_t, int8_t) {}
void motor_set(uint8_t, float) {}
void pose_set(uint8_t, const motion *) {}
void lights_set(uint8_t, uint16_t) {}
void valve_set(uint8_t, float) {}

/* Has the driver of a sensor report a value; returns how many bytes the value has, 0 without such a sensor. A value that
 * is null is not reported. */
uint8_t report(uint8_t id, uint8_t channel, const uint8_t *value) {
  motion moved;
#define REPORT(number, size, call) \
  case number: \
    if (value) \
      call; \
    return size
  switch (id) {
    REPORT(0, 2, plain_sense(channel, j2a_get_i16(value)));
    REPORT(1, 2, queued_sense(channel, j2a_get_u16(value)));
    REPORT(2, 4, tuned_sense(channel, j2a_get_i32(value)));
    REPORT(4, 4, level_sense(channel, j2a_get_f32(value)));
    REPORT(5, 1, slow_sense(channel, *value));
    REPORT(254, 2, wide_sense(channel, j2a_get_u16(value)));
    case 3:
      if (value) {
        j2a_take_motion(&moved, value);
        imu_sense(channel, &moved);
      }
      return 18;
    default:
      return 0;
  }
}

/* Takes an id, and then values, each with its channel before. */
uint8_t stimulus(uint8_t *const length, uint8_t **const payload) {
  const uint8_t *at = *payload;
  const uint8_t *const end = at + *length;
  const uint8_t id = *at++;
  const uint8_t size = at > end ? 0 : report(id, 0, nullptr);
  *length = 0;
  if (size == 0)
    return J2A_RET_FAILED;
  for (; end - at > size; at += 1 + size)
    report(id, *at, at + 1);
  return at == end ? J2A_RET_OK : J2A_RET_FAILED;
}

/* Returns the first byte of its payload. */
uint8_t ret(uint8_t *const length, uint8_t **const payload) {
  const uint8_t code = (*payload)[0];
  if (*length == 0)
    return J2A_RET_FAILED;
  *length = 0;
  return code;
}

/* Returns after so many milliseconds. */
uint8_t wait(uint8_t *const length, uint8_t **const payload) {
  if (*length != 2)
    return J2A_RET_FAILED;
  delay(j2a_get_u16(*payload));
  *length = 0;
  return J2A_RET_OK;
}

J2A_FUNCTIONS(J2A_CALL(stimulus, stimulus), J2A_CALL(ret, ret), J2A_CALL(delay, wait));
J2A_PROPERTIES(J2A_PROPERTY("name", "J2A transducers"));

void setup() {
  Serial.begin(115200);
  J2A.begin(Serial);
  transds_init();
}

void loop() {
  J2A.task();
  transds_process();
}
