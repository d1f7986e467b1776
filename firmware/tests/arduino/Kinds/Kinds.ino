/* Transducers of each kind of type. An actuator gives its value to the sensor of the same type. */
#define J2A_TRANSDUCERS \
  J2A_ENUM(mode, u8, (off, 0), (on, 1)) \
  J2A_STRUCT(motion, (array(i16, 3), rate, mdeg/s), (f32, heat, Cel)) \
  SENSOR(imu, 0, imu, X, 1, motion, none) \
  SENSOR(matrix, 1, matrix, X, 2, array(u16, 3), none, (queue, 4)) \
  SENSOR(state, 2, state, X, 1, mode, none) \
  SENSOR(level, 3, level, X, 1, float, nan, (threshold, 0.5), (decimation, 1), (topic, a/b)) \
  ACTUATOR(move, 10, move, X, 1, motion, none) \
  ACTUATOR(row, 11, row, X, 1, array(u16, 3), none) \
  ACTUATOR(switch_, 12, toggle, X, 1, mode, none) \
  ACTUATOR(target, 13, target, X, 1, float, 1.5, (range, -2.5, 2.5))
#include <J2A.h>

J2A_SENSE(imu);
J2A_SENSE(matrix);
J2A_SENSE(state);

/* A driver as elsewhere. */
void (*level_callback)(uint8_t channel, float value);

void level_set_cb(void (*callback)(uint8_t channel, float value)) {
  level_callback = callback;
}

void move_set(uint8_t channel, const motion *value) {
  imu_sense(channel, value);
}

void row_set(uint8_t, const uint16_t *value) {
  matrix_sense(1, value);
}

void toggle_set(uint8_t channel, mode value) {
  state_sense(channel, value == mode_off ? mode_on : mode_off);
}

void target_set(uint8_t channel, float value) {
  level_callback(channel, value);
}

uint8_t one() {
  return 1;
}

J2A_FUNCTIONS(J2A_FUNCTION(one, ": One."));
J2A_PROPERTIES();

void setup() {
  const motion early = {{0, 0, 0}, 0};
  imu_sense(0, &early); /* nothing */
  Serial.begin(115200);
  J2A.begin(Serial);
  transds_init();
}

void loop() {
  J2A.task();
  transds_process();
}
