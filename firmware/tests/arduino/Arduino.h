/* As much of an Arduino core as the library needs, for this machine: a Stream on a ring that drops what
 * comes when it is full, String, and a clock that the test sets. */
#ifndef ARDUINO_H
#define ARDUINO_H

#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

class Stream {
public:
    virtual ~Stream() {
    }
    virtual int available() = 0;
    virtual int read() = 0;
    virtual size_t write(uint8_t byte) = 0;
    virtual size_t write(const uint8_t *bytes, size_t count) = 0;
};

class String {
public:
    String(const char *text = "") : text(strdup(text)) {
    }
    String(const String &other) : String(other.text) {
    }
    ~String() {
        free(text);
    }
    unsigned length() const {
        return static_cast<unsigned>(strlen(text));
    }
    const char *c_str() const {
        return text;
    }

private:
    String &operator=(const String &);
    char *text;
};

uint32_t micros();
uint32_t millis();

#endif
