/* The push parser. Bytes of the link flow in one by one; out comes an event in j2a_rx: a frame whose
 * checksum is right, or the code of an error to be sent. Rules: it never waits and sends nothing.
 * A raw marker always ends the frame in work; a raw SOF always starts a new one. Bytes outside a
 * frame are skipped. An error is only reported when the frame's seq was received. */
#include "j2a_internal.h"

enum { IDLE, SEQ, OPCODE, LENGTH, PAYLOAD, CHECKSUM };

j2a_rx_t j2a_rx;

/* Reports that the frame ended before it was complete. state: what was due next. Returns true. */
static bool ended(uint8_t state, uint8_t code, uint8_t site) {
    if (state > SEQ) {
        j2a_rx.site = site;
        j2a_rx.event = code;
    }
    return true;
}

static bool abandon(uint8_t code, uint8_t site) {
    const uint8_t state = j2a_rx.state;
    j2a_rx.state = IDLE;
    return ended(state, code, site);
}

/* Half of the time that an AVR has for a byte at 1 Mbaud is spent here. So the usual case comes
 * first, and other functions are called only as the last act: then no registers need saving. */
bool j2a_rx_byte(uint8_t byte) {
    uint8_t state = j2a_rx.state;

    if (state <= SEQ) { /* only then can an event wait */
        if (j2a_rx.event != J2A_EVENT_NONE)
            return false;
        if (state == IDLE && byte != J2A_SOF)
            return true;
    }
    j2a_rx.fed = true;

    if (byte == J2A_SOF || byte == J2A_SOS) {
        j2a_rx.escaped = false;
        j2a_rx.checksum = 0;
        j2a_rx.count = 0;
        j2a_rx.state = byte == J2A_SOF ? SEQ : IDLE;
        return ended(state, J2A_ERR_FRAMING, J2A_SITE_MARKER);
    }
    if (j2a_rx.escaped) {
        j2a_rx.escaped = false;
        if (byte == 0xFF)
            return abandon(J2A_ERR_FRAMING, J2A_SITE_ESCAPE);
        byte++;
    } else if (byte == J2A_ESC) {
        j2a_rx.escaped = true;
        return true;
    }

    if (state == PAYLOAD) {
        const uint8_t count = j2a_rx.count;
        j2a_rx.checksum ^= byte;
        j2a_rx.payload[count] = byte;
        j2a_rx.count = (uint8_t)(count + 1);
        if (j2a_rx.count == j2a_rx.length)
            j2a_rx.state = CHECKSUM;
        return true;
    }
    if (state == CHECKSUM) {
        if (byte != j2a_rx.checksum)
            return abandon(J2A_ERR_CHECKSUM, J2A_SITE_CHECKSUM);
        j2a_rx.state = IDLE;
        j2a_rx.event = J2A_EVENT_FRAME;
        return true;
    }
    if (state == SEQ) {
        j2a_rx.seq = byte;
    } else if (state == OPCODE) {
        j2a_rx.opcode = byte;
        byte = (uint8_t)(byte + J2A_CHK_OPCODE);
    } else {
        j2a_rx.length = byte;
        if (byte == 0)
            state++;
        byte = (uint8_t)(byte + J2A_CHK_LENGTH);
    }
    j2a_rx.checksum ^= byte;
    j2a_rx.state = (uint8_t)(state + 1);
    return true;
}

void j2a_rx_lost(void) {
    if (j2a_rx.event == J2A_EVENT_NONE)
        abandon(J2A_ERR_FRAMING, J2A_SITE_LOST);
    else
        j2a_rx.state = IDLE;
}

void j2a_rx_timeout(void) {
    abandon(J2A_ERR_TIMEOUT, J2A_SITE_TIMEOUT);
}

bool j2a_rx_busy(void) {
    return j2a_rx.state != IDLE;
}
