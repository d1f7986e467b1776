/* A model servo at pin 9, set by the host.
 *
 *   servo    takes 2 bytes of microseconds, 500 to 2500: the length of the pulse; 1500 is the middle, 0 off
 *   position replies these 2 bytes
 *
 * The pulse is made here every 20 ms, so the sketch needs nothing but a pin; an interrupt may lengthen a
 * pulse by a few microseconds. The library Servo makes steadier ones with a timer: then servo calls
 * writeMicroseconds(), and loop() only J2A.task(). */
#include <J2A.h>

const uint8_t SERVO_PIN = 9;
const uint32_t PERIOD_US = 20000;
const uint16_t SHORTEST_US = 500;
const uint16_t LONGEST_US = 2500;

uint16_t pulse_us = 0;
uint32_t last_us = 0;

uint8_t servo(uint8_t *const length, uint8_t **const payload) {
  const uint16_t wanted_us = (*payload)[0] | (uint16_t)(*payload)[1] << 8;
  const bool good = *length == 2 && (wanted_us == 0 || (wanted_us >= SHORTEST_US && wanted_us <= LONGEST_US));
  *length = 0;
  if (!good)
    return J2A_RET_FAILED;
  pulse_us = wanted_us;
  return J2A_RET_OK;
}

uint8_t position(uint8_t *const length, uint8_t **const payload) {
  (*payload)[0] = pulse_us & 0xFF;
  (*payload)[1] = pulse_us >> 8;
  *length = 2;
  return J2A_RET_OK;
}

J2A_FUNCTIONS(
  J2A_CALL(servo, servo),
  J2A_CALL(position, position)
);

J2A_PROPERTIES(
  J2A_PROPERTY("name", "Servo")
);

void setup() {
  pinMode(SERVO_PIN, OUTPUT);
  Serial.begin(115200);
  J2A.begin(Serial);
}

void loop() {
  J2A.task();
  if (micros() - last_us >= PERIOD_US) {
    last_us = micros();
    if (pulse_us != 0) {
      digitalWrite(SERVO_PIN, HIGH);
      delayMicroseconds(pulse_us);
      digitalWrite(SERVO_PIN, LOW);
    }
  }
}
