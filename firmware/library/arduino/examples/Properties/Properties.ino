/* What a board says about itself: `j2a info URL` shows it.
 *
 * Properties are texts in flash. j2a.spec, the version of the protocol, is there without being listed.
 * j2a.rxbuf is a promise to the host: so many bytes of requests may be on their way at once. The Serial of
 * an AVR holds 63, and is taken to have lost something when it is full, so 62 can be promised. Leave the
 * line out where you do not know: then the host waits for each reply. */
#include <J2A.h>

#if defined(__AVR__) && !defined(USBCON)
#define ROOM J2A_PROPERTY("j2a.rxbuf", "62")
#else
#define ROOM /* an empty item is none */
#endif

uint32_t uptime() {
  return millis();
}

J2A_FUNCTIONS(
  J2A_FUNCTION(uptime, "-> ms: Returns the time since the start.")
);

J2A_PROPERTIES(
  J2A_PROPERTY("name", "Properties"),
  J2A_PROPERTY("serial", "0001"),
  J2A_PROPERTY("clock", J2A_TEXT(F_CPU)),
  ROOM
);

void setup() {
  Serial.begin(115200);
  J2A.begin(Serial);
}

void loop() {
  J2A.task();
}
