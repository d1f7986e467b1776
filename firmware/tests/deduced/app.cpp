/* Plain functions of every type that J2A_FUNCTION deduces, each of which gives back what it got. */
#include <string.h>

#include "j2a.h"

enum class Mode : uint8_t { off, on };
enum Level : int16_t { low = -300, high = 300 };
enum class Door : bool { shut, open };

static uint8_t calls;

bool bools(bool value) { return value; }
uint8_t u8s(uint8_t value) { return value; }
uint16_t u16s(uint16_t value) { return value; }
uint32_t u32s(uint32_t value) { return value; }
uint64_t u64s(uint64_t value) { return value; }
int8_t i8s(int8_t value) { return value; }
int16_t i16s(int16_t value) { return value; }
int32_t i32s(int32_t value) { return value; }
int64_t i64s(int64_t value) { return value; }
float f32s(float value) { return value; }
double f64s(const double &value) { return value; }
Mode modes(Mode value) { return value; }
static Level levels(Level value) { return value; }
Door doors(Door value) noexcept { return value; }
void nothing() { calls++; }
uint8_t count() { return calls; }
const char *texts(const char *text) { return text; }
const char *missing(uint8_t length) {
    static char text[300];
    memset(text, 'x', sizeof text);
    text[length + (length == 255)] = '\0';
    return length == 0 ? nullptr : text;
}
int32_t divide(int32_t a, int32_t b) {
    if (b == 0)
        return j2a_fail(7);
    return a / b;
}
void split(int32_t value, uint8_t &low, int32_t &rest, bool &negative) {
    low = static_cast<uint8_t>(value & 0xFF);
    rest = value >> 8;
    negative = value < 0;
}
void refuse(uint8_t code, uint16_t &result) {
    result = 0x1234;
    j2a_fail(code);
}
void reverse(const int16_t (&values)[3], int16_t (&reversed)[3], uint8_t &calls_so_far) {
    for (uint8_t i = 0; i < 3; i++)
        reversed[i] = values[2 - i];
    calls_so_far = ++calls;
}
const char *greet(uint8_t times, uint16_t wide, const char *name) {
    static char text[256];
    text[0] = '\0';
    for (uint16_t i = 0; i < times && strlen(text) + strlen(name) < 250; i++)
        strcat(text, name);
    return wide == 0 ? "" : text;
}
void eight(bool a, int8_t b, uint16_t c, int32_t d, uint64_t e, float f, double g, uint8_t h, bool &a2, int8_t &b2,
           uint16_t &c2, int32_t &d2, uint64_t &e2, float &f2, double &g2, uint8_t &h2) {
    a2 = a, b2 = b, c2 = c, d2 = d, e2 = e, f2 = f, g2 = g, h2 = h;
}
void untouched(uint32_t, uint32_t &a, int16_t (&b)[3]) {
    (void)a, (void)b;
}
uint8_t raw(uint8_t *const length, uint8_t **const) { return *length; }

uint8_t memory[300];
int16_t curve[200];

j2a::sif<0x20, uint32_t, int16_t> report;
const j2a::sif<255, const uint8_t (&)[2]> pair;
j2a::sif<7> bare;
void send(uint32_t time, int16_t value, const uint8_t (&two)[2]) {
    report(time, value);
    pair(two);
    bare();
}

J2A_FUNCTIONS(
    J2A_FUNCTION(bools, "value:"),
    J2A_FUNCTION(u8s, "value:"),
    J2A_FUNCTION(u16s, "value:"),
    J2A_FUNCTION(u32s, "value:"),
    J2A_FUNCTION(u64s, "value(us) -> us:"),
    J2A_FUNCTION(i8s, "value:"),
    J2A_FUNCTION(i16s, "value:"),
    J2A_FUNCTION(i32s, "value:"),
    J2A_FUNCTION(i64s, "value:"),
    J2A_FUNCTION(f32s, "-> m/s2 value(m/s2) : Accelerates: no more."),
    J2A_FUNCTION(f64s, "value:"),
    J2A_FUNCTION(modes, "value:"),
    J2A_FUNCTION(levels, "value:"),
    J2A_FUNCTION(doors, "value:"),
    J2A_CALL(raw, raw),
    J2A_FUNCTION(nothing, "Does nothing."),
    J2A_FUNCTION(count, ""),
    J2A_FUNCTION(texts, "text !slow(65535) !idempotent: The same."),
    J2A_FUNCTION(missing, "length:Of so many."),
    J2A_FUNCTION(divide, "a b: Fails with 7."),
    J2A_FUNCTION(split, "value low rest([in_i]) negative:"),
    J2A_FUNCTION(refuse, "code result:"),
    J2A_FUNCTION(reverse, "values(mV) values(mV) calls:"),
    J2A_FUNCTION(greet, "times wide name:"),
    J2A_FUNCTION(eight, "a b c d e f g h a b c d e f g h:"),
    J2A_FUNCTION(untouched, "value a b:"),
    J2A_FUNCTION(send, "time value two:"),
    J2A_BUFFER(memory, "Bytes."),
    J2A_BUFFER(curve, "-> mV:"),
    J2A_SIF(report, "time(ms) value: A reading."),
    J2A_SIF(pair, "two:"),
    J2A_SIF(bare, ""),
);
J2A_PROPERTIES(J2A_PROPERTY("name", "deduced"));

int main(int argc, char **argv) {
    j2a_port_init(argc, argv);
    for (;;) {
        j2a_task();
        j2a_port_idle();
    }
}
