/* Types of C++ whose sizes are an AVR's. */
#include <J2A.h>

enum Mode : uint8_t { off, on };

void numbers(int a, unsigned b, long c, char d, double e, int &a2, unsigned &b2, long &c2, char &d2, double &e2) {
  a2 = a, b2 = b, c2 = c, d2 = d, e2 = e;
}

int mode(Mode mode) {
  return mode;
}

int middle(const int (&values)[3]) {
  return values[1];
}

String text(uint8_t times, String text) {
  String all;
  for (; times > 0; times--)
    all += text;
  return all;
}

J2A_FUNCTIONS(
  J2A_FUNCTION(numbers, "a b c d e a b c d e:"),
  J2A_FUNCTION(mode, "mode:"),
  J2A_FUNCTION(middle, "values -> mV:"),
  J2A_FUNCTION(text, "times text: Repeats the text.")
);
J2A_PROPERTIES();

void setup() {
  Serial.begin(115200);
  J2A.begin(Serial);
}

void loop() {
  J2A.task();
}
