/* Functions that a host calls by name: led switches the LED of the board, add adds, hello greets.
 *
 *   j2a call serial:///dev/ttyACM0?baud=115200 led true
 *   j2a call serial:///dev/ttyACM0?baud=115200 add 40 2
 *   j2a call serial:///dev/ttyACM0?baud=115200 hello World
 *
 * They are plain functions: the compiler finds out their types, and a text names their parameters. */
#include <J2A.h>

void led(bool on) {
  digitalWrite(LED_BUILTIN, on ? HIGH : LOW);
}

long add(long a, long b) {
  return a + b;
}

String hello(const String &name) {
  return "Hello, " + name + "!";
}

J2A_FUNCTIONS(
  J2A_FUNCTION(led, "on: Switches the LED."),
  J2A_FUNCTION(add, "a b: Adds two numbers."),
  J2A_FUNCTION(hello, "name: Greets.")
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
