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
    //@ split code; // a state with an error is not taken together with one without
    payload[0] = any_u8;
    payload[1] = any_u8;
    *length = 2;
    return code;
}

uint16_t j2a_port_ticks(void) {
    return any_u16;
}

/* Calls of the parser; those of bytes with a way of their own are apart. */
enum { LOSS, TIMEOUT, SOF, SOS, ESC, LENGTH_ZERO, OTHER_BYTE, CALLS };

/* Returns any byte but SOF and SOS, and ESC only where it is a byte like others. That leaves up to 254
 * values, which Eva keeps as a list, see -eva-ilevel in prove.py; an interval would have SOF and SOS in it. */
static uint8_t other_byte(bool is_escaped) {
    const uint8_t byte = any_u8;
    if (byte < J2A_SOF)
        return byte;
    if (byte > J2A_SOF && byte < J2A_ESC)
        return byte;
    if (is_escaped && byte == J2A_ESC)
        return byte;
    if (byte > J2A_ESC && byte < J2A_SOS)
        return byte;
    return byte > J2A_SOS ? byte : 0;
}

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
        j2a_rx_timeout();
        //@ check j2a_rx.state == P_IDLE;
    } else if (event != J2A_EVENT_NONE && state == P_IDLE && any_bool) {
        j2a_rx_parse(byte); /* j2a_poll() does so directly after a loss whose error waits */
        //@ check j2a_rx.state <= P_SEQ;
    } else {
        push(state, event, byte);
    }
    /* An event is never replaced, and none comes of a frame whose seq is unknown (J2A-ERR-005). */
    if (event != J2A_EVENT_NONE || DUE(state) <= P_SEQ) {
        //@ check j2a_rx.event == event;
    }
    //@ check sound_parser;
}

static const uint8_t events[] = {J2A_EVENT_NONE, J2A_EVENT_FRAME, J2A_ERR_TIMEOUT,
                                 J2A_ERR_CHECKSUM, J2A_ERR_FRAMING};
static const uint8_t states[] = {
    P_IDLE, P_SEQ, P_OPCODE, P_LENGTH, P_PAYLOAD, P_CHECKSUM, P_SEQ + P_ESCAPED, P_OPCODE + P_ESCAPED,
    P_LENGTH + P_ESCAPED, P_PAYLOAD + P_ESCAPED, P_CHECKSUM + P_ESCAPED};

int main(void) {
    const uint8_t state = states[any_u8 % sizeof states];
    const uint8_t call = any_u8 % CALLS;
    uint8_t byte;
    uint8_t event = J2A_EVENT_NONE;
    uint8_t length = any_u8;
    uint8_t count = any_u8;
    uint8_t due;

    //@ split state;
    due = DUE(state);
    //@ split call;
    byte = call == SOF ? J2A_SOF : call == SOS ? J2A_SOS : call == ESC ? J2A_ESC
        : call == LENGTH_ZERO ? 0 : other_byte(state >= P_ESCAPED);
    if (due == P_LENGTH ? call == OTHER_BYTE && byte == 0 : call == LENGTH_ZERO)
        return 0; /* a length of 0 is a call of its own */
    if (call == ESC && state >= P_ESCAPED)
        return 0; /* see other_byte() */
    if (state <= P_SEQ)
        event = events[any_u8 % sizeof events];
    //@ split event;
    if (call == TIMEOUT && event != J2A_EVENT_NONE)
        return 0; /* j2a_poll() gives up a frame only while nothing waits */
    if (event > J2A_EVENT_FRAME)
        length = 2;
    if (due >= P_SEQ && due <= P_LENGTH)
        count = 0;
    j2a_rx.state = state;
    j2a_rx.event = event;
    j2a_rx.last_ticks = any_u16;
    j2a_rx.checksum = any_u8;
    j2a_rx.seq = any_u8;
    j2a_rx.opcode = any_u8;
    j2a_rx.payload[any_u8 % J2A_ROOM] = any_u8;
    if (due == P_PAYLOAD && call >= ESC) { /* other calls are proven for more states than are sound */
        /* Each length; the last byte of the payload apart from the others, as another state follows. */
        const bool last = call != ESC && any_bool;
        length = length % 255 + 1;
        //@ split length;
        //@ split last;
        if (call == ESC)
            count %= length;
        else if (last || length == 1)
            count = length - 1;
        else
            count %= length - 1;
    }
    j2a_rx.length = length;
    j2a_rx.count = count;
    if (due != P_PAYLOAD || call >= ESC) {
        //@ check sound_parser;
    }
    step(call, state, event, byte);
    return 0;
}
