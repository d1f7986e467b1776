/* The push parser. Bytes of the link flow in one by one; out comes an event in j2a_rx: a frame whose
 * checksum is right, or the code of an error to be sent. Rules: it never waits and sends nothing.
 * A raw marker always ends the frame in work; a raw SOF always starts a new one. Bytes outside a
 * frame are skipped. An error is only reported when the frame's seq was received. */
#include "j2a_internal.h"

enum { IDLE, SEQ, OPCODE, LENGTH, PAYLOAD, CHECKSUM };

j2a_rx_t j2a_rx;

static void abandon(uint8_t code, uint8_t site) {
    if (j2a_rx.state > SEQ) {
        j2a_rx.site = site;
        j2a_rx.event = code;
    }
    j2a_rx.state = IDLE;
}

bool j2a_rx_byte(uint8_t byte) {
    uint8_t state = j2a_rx.state;

    if (j2a_rx.event != J2A_EVENT_NONE)
        return false;
    j2a_rx.fed = true;

    if (byte == J2A_SOF || byte == J2A_SOS) {
        abandon(J2A_ERR_FRAMING, J2A_SITE_MARKER);
        j2a_rx.escaped = false;
        j2a_rx.checksum = 0;
        j2a_rx.count = 0;
        if (byte == J2A_SOF)
            j2a_rx.state = SEQ;
        return true;
    }
    if (state == IDLE)
        return true;
    if (j2a_rx.escaped) {
        j2a_rx.escaped = false;
        if (byte++ == 0xFF) {
            abandon(J2A_ERR_FRAMING, J2A_SITE_ESCAPE);
            return true;
        }
    } else if (byte == J2A_ESC) {
        j2a_rx.escaped = true;
        return true;
    }

    if (state == PAYLOAD) {
        j2a_rx.checksum ^= byte;
        j2a_rx.payload[j2a_rx.count++] = byte;
        if (j2a_rx.count == j2a_rx.length)
            j2a_rx.state = CHECKSUM;
        return true;
    }
    if (state == CHECKSUM) {
        if (byte == j2a_rx.checksum) {
            j2a_rx.state = IDLE;
            j2a_rx.event = J2A_EVENT_FRAME;
        } else {
            abandon(J2A_ERR_CHECKSUM, J2A_SITE_CHECKSUM);
        }
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
