/* An analog sensor that is asked, or that reports by itself.
 *
 *   j2a call serial:///dev/ttyACM0?baud=115200 analog 0
 *   j2a watch serial:///dev/ttyACM0?baud=115200 --call 'every 500' --then 'every 0'
 *
 * A report is a frame that the host did not ask for, a SIF, with the opcode 0x20. */
#include <J2A.h>

j2a::sif<0x20, uint32_t, uint16_t> report;

uint16_t period_ms = 0;
uint32_t last_ms = 0;

uint16_t analog(uint8_t channel) {
  if (channel >= NUM_ANALOG_INPUTS)
    return j2a_fail(1);
  return analogRead(channel);
}

void every(uint16_t period) {
  period_ms = period;
  last_ms = millis();
}

uint16_t sum() {
  uint16_t total = 0;
  for (uint8_t i = 0; i < 16; i++)
    total += analogRead(A0);
  return total;
}

J2A_FUNCTIONS(
  J2A_FUNCTION(analog, "channel: Returns the value of an analog input, 0 to 1023 on most boards; fails without such an input."),
  J2A_FUNCTION(every, "period(ms) !idempotent: Sends the SIF report periodically; 0 stops it."),
  J2A_FUNCTION(sum, "Returns the sum of 16 readings of A0."),
  J2A_SIF(report, "time(ms) value: A reading of A0.")
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
    last_ms += period_ms;
    report(last_ms, analogRead(A0));
  }
}
