/* An analog sensor that is asked, or that reports by itself.
 *
 *   analog   takes the number of an analog input, replies its value, 2 bytes: 0 to 1023 on most boards
 *   every    takes 2 bytes of milliseconds; from then on A0 is reported in this rhythm, 0 ends it
 *   average  replies the average of A0 in 16 readings, in sixteenths
 *
 * A report is a frame with the opcode 0x20: 4 bytes of millis(), 2 bytes of value. Numbers are
 * little-endian. */
#include <J2A.h>

const uint8_t REPORT = 0x20;

uint16_t period_ms = 0;
uint32_t last_ms = 0;

void put_u16(uint8_t *bytes, uint16_t value) {
  bytes[0] = value & 0xFF;
  bytes[1] = value >> 8;
}

uint8_t failed(uint8_t *const length) {
  *length = 0;
  return J2A_RET_FAILED;
}

uint8_t analog(uint8_t *const length, uint8_t **const payload) {
  if (*length != 1 || (*payload)[0] >= NUM_ANALOG_INPUTS)
    return failed(length);
  put_u16(*payload, analogRead((*payload)[0]));
  *length = 2;
  return J2A_RET_OK;
}

uint8_t every(uint8_t *const length, uint8_t **const payload) {
  if (*length != 2)
    return failed(length);
  period_ms = (*payload)[0] | (uint16_t)(*payload)[1] << 8;
  last_ms = millis();
  *length = 0;
  return J2A_RET_OK;
}

uint8_t average(uint8_t *const length, uint8_t **const payload) {
  uint16_t sum = 0;
  for (uint8_t i = 0; i < 16; i++)
    sum += analogRead(A0);
  put_u16(*payload, sum);
  *length = 2;
  return J2A_RET_OK;
}

J2A_FUNCTIONS(
  J2A_CALL(analog, analog),
  J2A_CALL(every, every),
  J2A_CALL(average, average)
);

J2A_PROPERTIES(
  J2A_PROPERTY("name", "Sensor")
);

void setup() {
  Serial.begin(115200);
  J2A.begin(Serial);
}

void loop() {
  J2A.task();
  if (period_ms != 0 && millis() - last_ms >= period_ms) {
    uint8_t report[6];
    last_ms += period_ms;
    j2a_put_u32(report, last_ms);
    put_u16(report + 4, analogRead(A0));
    J2A.sendSif(REPORT, report, sizeof report);
  }
}
