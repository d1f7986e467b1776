/* A model servo at pin 9, set by the host.
 *
 *   j2a call serial:///dev/ttyACM0?baud=115200 servo 1500
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

void servo(uint16_t pulse) {
  if (pulse != 0 && (pulse < SHORTEST_US || pulse > LONGEST_US))
    j2a_fail(1);
  else
    pulse_us = pulse;
}

uint16_t position() {
  return pulse_us;
}

J2A_FUNCTIONS(
  J2A_FUNCTION(servo, "pulse(us) !idempotent: Sets the pulse, 500 to 2500; 1500 is the middle, 0 off."),
  J2A_FUNCTION(position, "-> us: Returns the pulse.")
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
