/* A host on two ordinary pins. */
#include <J2A.h>
#include <SoftwareSerial.h>

SoftwareSerial link(10, 11);

J2A_FUNCTIONS();
J2A_PROPERTIES(J2A_PROPERTY("name", "soft"));

void setup() {
  link.begin(9600);
  J2A.begin(link, 63);
}

void loop() {
  J2A.task();
}
