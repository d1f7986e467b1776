/* Data longer than a frame: 400 bytes that the host writes and reads as a whole, and a curve of 100 numbers.
 *
 *   j2a read serial:///dev/ttyACM0?baud=115200 content --out content.bin
 *
 * A function that makes its data when it is asked is of the kind "many", J2A_MANY in place of J2A_BUFFER: it is called
 * once for each chunk; the sketch Conformance has one. */
#include <J2A.h>

uint8_t content[400];
uint16_t curve[100];

J2A_FUNCTIONS(
  J2A_BUFFER(content, "What the host has written."),
  J2A_BUFFER(curve, "-> mV: A curve.")
);

J2A_PROPERTIES(
  J2A_PROPERTY("name", "Many")
);

void setup() {
  Serial.begin(115200);
  J2A.begin(Serial);
}

void loop() {
  J2A.task();
}
