/* The Arduino library as a device of lines. In, one command a line: "b HEX" bytes arrive, "m N" micros() is
 * N from now on, "i N" it becomes N behind its next call, in an interrupt that looks at the time, "c 0" nobody
 * takes what is written, "t" J2A.task(). Out: for each t a line of what was written, as hex. */
#include <stdio.h>
#include <string.h>

#include <J2A.h>

static uint32_t now_us, later_us;
static bool interrupts;

uint32_t micros() {
    const uint32_t us = now_us;
    if (interrupts) {
        interrupts = false;
        now_us = later_us;
        j2a_port_time_us();
    }
    return us;
}

uint32_t millis() {
    return now_us / 1000;
}

class Port : public Stream {
public:
    bool connected = true;

    int available() override {
        return static_cast<int>(count);
    }
    int read() override {
        int byte;
        if (count == 0)
            return -1;
        byte = ring[first];
        first = (first + 1) % sizeof ring;
        count--;
        return byte;
    }
    size_t write(uint8_t byte) override {
        return write(&byte, 1);
    }
    size_t write(const uint8_t *bytes, size_t length) override {
        size_t i;
        for (i = 0; connected && i < length; i++)
            printf("%02x", bytes[i]);
        return i;
    }
    void arrive(uint8_t byte) {
        if (count < sizeof ring)
            ring[(first + count++) % sizeof ring] = byte;
    }

private:
    uint8_t ring[63];
    size_t first = 0, count = 0;
};

static uint64_t getTime() {
    return j2a_port_time_us();
}

static uint8_t overruns(uint8_t *const length, uint8_t **const payload) {
    (*payload)[0] = static_cast<uint8_t>(J2A.overruns());
    *length = 1;
    return J2A_RET_OK;
}

static String greet(const String &name) {
    return String(name);
}

static String twice(uint8_t times, String name) {
    return times == 2 ? String("twice") : name;
}

static String large() {
    char text[J2A_ROOM + 2];
    memset(text, 'x', sizeof text - 1);
    text[sizeof text - 1] = '\0';
    return String(text);
}

J2A_FUNCTIONS(J2A_FUNCTION(getTime, ""), J2A_CALL(overruns, overruns), J2A_FUNCTION(greet, "name:"),
              J2A_FUNCTION(twice, "times name:"), J2A_FUNCTION(large, ""));
J2A_PROPERTIES();

int main(int argc, char **argv) {
    static char line[4096];
    static Port port;
    if (argc > 1 && strcmp(argv[1], "unknown") == 0)
        J2A.begin(port);
    else
        J2A.begin(port, 63);
    while (fgets(line, sizeof line, stdin) != nullptr) {
        unsigned value;
        const char *next = line + 2;
        if (line[0] == 'b') {
            for (; sscanf(next, "%2x", &value) == 1; next += 2)
                port.arrive(static_cast<uint8_t>(value));
        } else if (line[0] == 'm') {
            if (sscanf(next, "%u", &value) == 1)
                now_us = value;
        } else if (line[0] == 'i') {
            interrupts = sscanf(next, "%u", &later_us) == 1;
        } else if (line[0] == 'c') {
            port.connected = line[2] != '0';
        } else {
            J2A.task();
            printf("\n");
        }
    }
    return 0;
}
