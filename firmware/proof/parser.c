/* The parser, one step from any state that is sound. In: all that a link has, as far as sound_parser in
 * contracts.h allows. Out: the state after one call is sound again, whatever was called. By induction
 * it always is, as it is at the start, and as nobody else writes the fields it is made of. */
#include "contracts.h"
#include "any.h"

volatile uint8_t any_u8;
volatile uint16_t any_u16;

/* What the one of j2a_server.c promises, which program.c proves. */
uint8_t j2a_error(uint8_t code, uint8_t site, uint8_t *length, uint8_t *payload) {
    (void)site;
    payload[0] = any_u8;
    payload[1] = any_u8;
    *length = 2;
    return code;
}

uint16_t j2a_port_ticks(void) {
    return any_u16;
}

enum { LOSS, TIMEOUT, MARKER, OTHER_BYTE, BYTE_AFTER_LOSS, CALLS };

/* Pushes one byte; state and event are what they are before. */
static void push(uint8_t state, uint8_t event, uint8_t byte) {
    const bool taken = j2a_rx_byte(byte); /* which is j2a_rx_parse() for a byte that is taken */
    //@ split taken;
    if (!taken) {
        //@ check event != J2A_EVENT_NONE && j2a_rx.state == state;
    } else {
        //@ check event == J2A_EVENT_NONE;
        if (byte == J2A_SOF) { /* J2A-FRAME-007 */
            //@ check j2a_rx.state == P_SEQ && j2a_rx.count == 0 && j2a_rx.checksum == 0;
        } else if (byte == J2A_SOS || state == P_IDLE) { /* J2A-FRAME-008, J2A-FRAME-006 */
            //@ check j2a_rx.state == P_IDLE;
        }
    }
}

/* Calls one function of the parser. */
static void step(uint8_t call, uint8_t state, uint8_t event, uint8_t byte) {
    if (call == LOSS) {
        j2a_rx_lost();
        //@ check j2a_rx.state == P_IDLE;
    } else if (call == TIMEOUT) {
        if (event != J2A_EVENT_NONE)
            return; /* j2a_poll() gives up a frame only while nothing waits */
        j2a_rx_timeout();
        //@ check j2a_rx.state == P_IDLE;
    } else if (call == MARKER) {
        push(state, event, any_bool ? J2A_SOF : J2A_SOS);
    } else if (call == OTHER_BYTE) {
        if (byte == J2A_SOF || byte == J2A_SOS)
            return;
        push(state, event, byte);
    } else {
        if (state != P_IDLE)
            return; /* j2a_poll() does so directly after a loss only, while its error waits */
        j2a_rx_parse(byte);
        //@ check j2a_rx.state <= P_SEQ;
    }
    /* An event is never replaced, and none comes of a frame whose seq is unknown (J2A-ERR-005). */
    if (event != J2A_EVENT_NONE || DUE(state) <= P_SEQ) {
        //@ check j2a_rx.event == event;
    }
    //@ check sound_parser;
}

static const uint8_t events[] = {J2A_EVENT_NONE, J2A_EVENT_FRAME, J2A_ERR_TIMEOUT,
                                 J2A_ERR_CHECKSUM, J2A_ERR_FRAMING};

/* One call from any state that has these fields. */
static void from(uint8_t call, uint8_t state, uint8_t event, uint8_t length, uint8_t count) {
    const uint8_t byte = any_u8;
    /* Intervals that hold no byte with a meaning of its own. */
    const uint8_t kind = byte < J2A_SOF ? 0 : byte < J2A_ESC ? 1 : byte == J2A_ESC ? 2 : byte < J2A_SOS ? 3
        : byte < 0xFF ? 4 : 5;
    if (call == OTHER_BYTE) {
        //@ split kind;
    }
    j2a_rx.state = state;
    j2a_rx.event = event;
    j2a_rx.length = event > J2A_EVENT_FRAME ? 2 : length;
    j2a_rx.count = count;
    j2a_rx.last_ticks = any_u16;
    j2a_rx.checksum = any_u8;
    j2a_rx.seq = any_u8;
    j2a_rx.opcode = any_u8;
    j2a_rx.payload[any_u8 % J2A_ROOM] = any_u8;
    if (DUE(state) != P_PAYLOAD || call == OTHER_BYTE) { /* other calls are proven for more states than are sound */
        //@ check sound_parser;
    }
    step(call, state, event, byte);
}

/* A byte inside the payload, for each length; the last byte of the payload apart from the others. */
static void in_payload(uint8_t state) {
    uint8_t length;
    //@ loop unroll 255;
    for (length = 255; length != 0; length--) {
        const uint8_t count = any_u8;
        from(OTHER_BYTE, state, J2A_EVENT_NONE, length, length - 1);
        if (count + 1 < length)
            from(OTHER_BYTE, state, J2A_EVENT_NONE, length, count);
    }
}

int main(void) {
    const uint8_t state = any_u8;
    const uint8_t call = any_u8 % CALLS;
    uint8_t event = J2A_EVENT_NONE;
    uint8_t due;

    //@ split state;
    due = DUE(state);
    if (due > P_CHECKSUM || state == P_IDLE + P_ESCAPED)
        return 0;
    //@ split call;
    if (state <= P_SEQ)
        event = events[any_u8 % sizeof events];
    //@ split event;
    if (due == P_PAYLOAD && call == OTHER_BYTE)
        in_payload(state);
    else
        from(call, state, event, any_u8, due < P_SEQ || due > P_LENGTH ? any_u8 : 0);
    return 0;
}
