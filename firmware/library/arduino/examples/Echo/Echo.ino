/* Two functions that a host calls by name: led switches the LED of the board, reverse sends a text back to
 * front.
 *
 *   j2a call serial:///dev/ttyACM0?baud=115200 led 01
 *
 * A function finds the request in payload, *length bytes of it, and leaves the reply there; what it returns,
 * 0 for success, goes to the host, too. */
#include <J2A.h>

uint8_t led(uint8_t *const length, uint8_t **const payload) {
  if (*length != 1) {
    *length = 0;
    return J2A_RET_FAILED;
  }
  digitalWrite(LED_BUILTIN, (*payload)[0] ? HIGH : LOW);
  *length = 0;
  return J2A_RET_OK;
}

uint8_t reverse(uint8_t *const length, uint8_t **const payload) {
  uint8_t *bytes = *payload;
  for (uint8_t first = 0, last = *length; first + 1 < last; first++) {
    last--;
    const uint8_t kept = bytes[first];
    bytes[first] = bytes[last];
    bytes[last] = kept;
  }
  return J2A_RET_OK;
}

J2A_FUNCTIONS(
  J2A_CALL(led, led),
  J2A_CALL(reverse, reverse)
);

J2A_PROPERTIES(
  J2A_PROPERTY("name", "Echo")
);

void setup() {
  pinMode(LED_BUILTIN, OUTPUT);
  Serial.begin(115200);
  J2A.begin(Serial);
}

void loop() {
  J2A.task();
}
