/* The parser, one step from any state that is sound. In: all of j2a_rx, as far as sound_parser in
 * contracts.h allows. Out: the state after one call is sound again, whatever was called. By induction
 * it always is, as it is at the start, and as nobody else writes the fields it is made of. */
#include "contracts.h"
#include "any.h"

volatile uint8_t any_u8;

/* Calls one function of the parser; state and event are what they are before. */
static void step(uint8_t state, uint8_t event) {
    if (any_bool) {
        j2a_rx_lost();
        //@ check j2a_rx.state == P_IDLE;
    } else if (any_bool) {
        if (event != J2A_EVENT_NONE)
            return; /* j2a_poll() gives up a frame only while nothing waits */
        j2a_rx_timeout();
        //@ check j2a_rx.state == P_IDLE;
    } else if (any_bool) {
        const bool busy = j2a_rx_busy();
        //@ check busy == (state != P_IDLE ? 1 : 0);
    } else {
        const uint8_t byte = any_u8;
        const uint8_t kind = byte < J2A_SOF ? 0 : byte == J2A_SOF ? 1 : byte < J2A_SOS ? 2 : byte == J2A_SOS ? 3 : 4;
        bool taken;
        //@ split kind;
        taken = j2a_rx_byte(byte);
        //@ split taken;
        if (!taken) {
            //@ check event != J2A_EVENT_NONE;
            //@ check j2a_rx.state == state;
        } else if (kind == 1) { /* J2A-FRAME-007 */
            //@ check j2a_rx.state == P_SEQ && j2a_rx.escaped == 0;
            //@ check j2a_rx.count == 0 && j2a_rx.checksum == 0;
        } else if (kind == 3) { /* J2A-FRAME-008 */
            //@ check j2a_rx.state == P_IDLE;
        } else if (state == P_IDLE) { /* J2A-FRAME-006 */
            //@ check j2a_rx.state == P_IDLE && j2a_rx.event == event;
        }
    }
    /* An event is never replaced, and none comes of a frame whose seq is unknown (J2A-ERR-005). */
    if (event != J2A_EVENT_NONE || state <= P_SEQ) {
        //@ check j2a_rx.event == event;
    }
    //@ check sound_parser;
}

int main(void) {
    const uint8_t state = any_u8;
    static const uint8_t events[] = {J2A_EVENT_NONE, J2A_EVENT_FRAME, J2A_ERR_TIMEOUT,
                                     J2A_ERR_CHECKSUM, J2A_ERR_FRAMING};
    const uint8_t length = any_u8;
    const uint8_t count = any_u8;
    uint8_t event = J2A_EVENT_NONE;

    if (state > P_CHECKSUM)
        return 0;
    //@ split state;
    if (state <= P_SEQ)
        event = events[any_u8 % sizeof events];
    //@ split event;
    if (state == P_PAYLOAD) {
        //@ split length;
        if (count >= length)
            return 0;
        j2a_rx.count = count;
    } else if (state < P_SEQ || state > P_LENGTH) {
        j2a_rx.count = count;
    }
    j2a_rx.state = state;
    j2a_rx.event = event;
    j2a_rx.length = length;
    j2a_rx.site = any_u8;
    j2a_rx.fed = any_bool;
    j2a_rx.escaped = any_bool;
    j2a_rx.checksum = any_u8;
    j2a_rx.seq = any_u8;
    j2a_rx.opcode = any_u8;
    j2a_rx.payload[any_u8 % J2A_MAX_PAYLOAD] = any_u8;
    //@ check sound_parser;
    step(state, event);
    return 0;
}
