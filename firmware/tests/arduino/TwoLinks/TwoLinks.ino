/* Two hosts at once: one on Serial, one on Serial1; which tells a host the link that it is on. */
#include <J2A.h>

uint8_t which(uint8_t *const length, uint8_t **const payload) {
  (*payload)[0] = j2a_link;
  *length = 1;
  J2A.sendSif(7, "hello", 5);
  return J2A_RET_OK;
}

J2A_FUNCTIONS(J2A_CALL(which, which));
J2A_PROPERTIES(J2A_PROPERTY("name", "two"));

void setup() {
  Serial.begin(250000);
  Serial1.begin(250000);
  J2A.beginLink(0, Serial);
  J2A.beginLink(1, Serial1);
}

void loop() {
  J2A.task();
}
