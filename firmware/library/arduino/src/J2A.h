/* J2A for sketches: a host calls the sketch's functions by name, over any Stream. In: one or more streams,
 * the lists J2A_FUNCTIONS and J2A_PROPERTIES of the sketch (see j2a_core.h) and, where the sketch defines it before
 * it includes this, the list J2A_TRANSDUCERS. Out: replies, samples, and frames sent unasked.
 * Rules: the stream belongs to J2A alone, so the sketch prints nothing to it; loop() calls J2A.task() and
 * returns soon; nothing of this is called from an interrupt. */
#ifndef J2A_ARDUINO_H
#define J2A_ARDUINO_H

#include <Arduino.h>

/* Of the files of one sketch, the one that lists transducers compiles their table. */
#ifdef J2A_TRANSDUCERS
#define J2A_DEF_FILES 1 /* functions.def and transds.def, which stand for the lists of the sketch */
#else
#undef J2A_WITH_TRANSDUCERS
#define J2A_WITH_TRANSDUCERS 0
#endif

#include "j2a_core.h"

#ifdef J2A_TRANSDUCERS
#if !J2A_WITH_TRANSDUCERS
#error "J2A_TRANSDUCERS needs J2A_WITH_TRANSDUCERS=1, so do not switch off it, SIF, MAPPING, MANY, PROPERTIES or CLOCK"
#endif
extern "C" {
#include "j2a_transds_table.h"
}
namespace j2a {
/* Is it the opcode of a sensor's samples? */
constexpr bool is_sensor(uint8_t opcode) {
#undef J2A_ENUM
#undef J2A_STRUCT
#undef J2A_TRANSD
#define J2A_ENUM(name, integer, ...)
#define J2A_STRUCT(name, ...)
#define J2A_TRANSD(KIND, name, id, ...) J2A_IS_##KIND(id) ||
#define J2A_IS_SENSOR(id) opcode == id
#define J2A_IS_ACTUATOR(id) false
    return
#include "j2a_transds_list.h"
        false;
}
} // namespace j2a
#endif

namespace j2a {
template <class F> struct sensed;
template <class... P> struct sensed<void(void (*)(P...))> {
    typedef void callback(P...);
    static void ignore(P...) {
    }
};
} // namespace j2a

/* A sensor that the sketch measures itself: makes its PREFIX_set_cb(), and PREFIX_sense(channel, value), by which the
 * sketch gives a value. Before transds_init() that does nothing. */
#define J2A_SENSE(prefix) \
    static j2a::sensed<decltype(prefix##_set_cb)>::callback *prefix##_sense = \
        j2a::sensed<decltype(prefix##_set_cb)>::ignore; \
    void prefix##_set_cb(j2a::sensed<decltype(prefix##_set_cb)>::callback *callback) { \
        prefix##_sense = callback; \
    } \
    static_assert(true, "") /* takes the semicolon of the user */

/* A String is a text, too. As a result it is copied into the reply. One that finds no memory is empty: then the call fails. */
namespace j2a {
template <> struct parameter<String> : text {
    String copy;
    explicit parameter(uint8_t *bytes, uint8_t length, bool has_others) : text(bytes, length, has_others), copy(value) {
    }
    bool is_whole() const {
        return copy.length() == strlen(value);
    }
    String &&pass() {
        return static_cast<String &&>(copy);
    }
};
template <> struct parameter<const String &> : parameter<String> {
    using parameter<String>::parameter;
};
template <> struct returned<String> {
    static constexpr bool is_void = false;
    static constexpr const char *element() {
        return "text";
    }
    template <class Values, class F> static uint8_t end(F function, Values &values, uint8_t *length, uint8_t **payload) {
        const String result = values.template call<String>(function);
        if (result.c_str() == nullptr || result.length() > J2A_ROOM)
            j2a_fail(J2A_RET_FAILED);
        else
            memcpy(*payload, result.c_str(), result.length());
        return j2a_end(length, static_cast<uint8_t>(result.length()));
    }
};
} // namespace j2a

class J2ADevice {
public:
    /* Serves a stream, which the sketch has begun.
     * holds: how many bytes wait in it at most, where it then drops what comes; 0: it makes the sender wait
     * (USB), or nobody knows, and then a loss is only noticed by the checksum. Of a Serial on an AVR it is
     * known. */
    template <class StreamType> void begin(StreamType &stream) {
        serve(0, stream, heldBy(&stream));
    }
    void begin(Stream &stream, uint16_t holds) {
        serve(0, stream, holds);
    }

#if J2A_LINKS > 1
    /* The same for link 0..J2A_LINKS-1, each of which has a host of its own. */
    template <class StreamType> void beginLink(uint8_t link, StreamType &stream) {
        serve(link, stream, heldBy(&stream));
    }
    void beginLink(uint8_t link, Stream &stream, uint16_t holds) {
        serve(link, stream, holds);
    }
#endif

    /* Receives and answers. */
    void task();

#if J2A_WITH_SIF
    /* Sends a frame unasked: an opcode 0..255 that host and sketch agree on, and up to 255 bytes. Of several
     * links it goes out on j2a_link: within a function the one that called it, else 0 or what the sketch has
     * set. */
    void sendSif(uint8_t opcode, const void *payload, uint8_t length);
#endif

    /* Adds text to what the host gets by a2jDebug. */
    void debug(const char *text);

    /* Times that received bytes were lost, as far as that is known. */
    uint16_t overruns();

private:
    static void serve(uint8_t link, Stream &stream, uint16_t holds);
    static uint16_t heldBy(Stream *) {
        return 0;
    }
#if defined(__AVR__) && defined(SERIAL_RX_BUFFER_SIZE)
    static uint16_t heldBy(HardwareSerial *) {
        return SERIAL_RX_BUFFER_SIZE - 1;
    }
#endif
};

extern J2ADevice J2A;

#endif
