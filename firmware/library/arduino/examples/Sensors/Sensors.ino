/* Sensors and a lamp that describe themselves: a host finds them by name, with units.
 *
 *   j2a watch serial:///dev/ttyACM0?baud=115200 light
 *
 * A photoresistor at A0 and a Sharp distance sensor at A1 are analog; the channels A and B of an encoder are at pins
 * 2 and 3, the lamp is at pin 9. */
#define J2A_TRANSDUCERS \
  SENSOR(light, 0, light, GL5528, 1, uint16_t, none, (unit, mV), (scale, 4.8828125), (period, 100000), "At A0.") \
  SENSOR(distance, 1, sharp, GP2Y0A02YK, 1, uint16_t, 0, (unit, mm), (range, 200, 1500), (trigger)) \
  SENSOR(encoder, 2, encoder, KY-040, 1, int16_t, none, (unit, deg), (scale, 9), "Positive is clockwise.") \
  ACTUATOR(lamp, 3, lamp, LED, 1, uint8_t, 0, (unit, %), (scale, 0.4), (range, 0, 250), (watchdog, 1000))
#include <J2A.h>

J2A_SENSE(light);
J2A_SENSE(sharp);
J2A_SENSE(encoder);

volatile int16_t position = 0;

void turned() {
  position += digitalRead(2) == digitalRead(3) ? -1 : 1;
}

void sharp_trigger() {
  const uint16_t value = analogRead(A1);
  const uint32_t distance = value > 2 ? 144200UL / value - 70 : 0; /* the curve of the data sheet, within 6 % */
  sharp_sense(0, distance < 200 || distance > 1500 ? 0 : distance);
}

void lamp_set(uint8_t, uint8_t value) {
  analogWrite(9, value == 250 ? 255 : value);
}

J2A_FUNCTIONS();
J2A_PROPERTIES(J2A_PROPERTY("name", "Sensors"));

void setup() {
  pinMode(2, INPUT_PULLUP);
  pinMode(3, INPUT_PULLUP);
  pinMode(9, OUTPUT);
  attachInterrupt(digitalPinToInterrupt(2), turned, CHANGE);
  Serial.begin(115200);
  J2A.begin(Serial);
  transds_init();
}

void loop() {
  static int16_t last = 0;
  J2A.task();
  transds_process();
  light_sense(0, analogRead(A0));
  noInterrupts();
  const int16_t now = position;
  interrupts();
  if (now != last)
    encoder_sense(0, last = now);
}
