/* Two hosts at once: one on Serial, one on Serial1; which tells a host the link that it is on. */
#include <J2A.h>

uint8_t which() {
  J2A.sendSif(7, "hello", 5);
  return j2a_link;
}

J2A_FUNCTIONS(J2A_FUNCTION(which, "Returns the link."));
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
