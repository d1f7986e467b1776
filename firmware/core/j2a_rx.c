/* The push parser. Bytes of the link flow in one by one; out comes an event in j2a_rx: a frame whose
 * checksum is right, or the code of an error to be sent. Rules: it never waits and sends nothing.
 * A raw marker always ends the frame in work; a raw SOF always starts a new one. Bytes outside a
 * frame are skipped. An error is only reported when the frame's seq was received. */
#include "j2a_internal.h"

enum { IDLE, SEQ, OPCODE, LENGTH, PAYLOAD, CHECKSUM, ESCAPED = 0x80 };

j2a_rx_t j2a_rx_of[J2A_LINKS];
#if J2A_LINKS > 1
uint8_t j2a_link;
#endif

/* Reports that the frame ended before it was complete. state: what was due next. */
static void ended(uint8_t state, uint8_t code, uint8_t site) {
    if ((state & ~ESCAPED) > SEQ) {
        j2a_rx.event = j2a_error(code, site, &j2a_rx.length, j2a_rx.payload);
    }
}

static void abandon(uint8_t code, uint8_t site) {
    const uint8_t state = j2a_rx.state;
    j2a_rx.state = IDLE;
    ended(state, code, site);
}

/* A byte that is not simply the next one of the payload. Returns true when it is one after all: the second
 * half of an escape, which *byte then is without. */
static bool other(uint8_t state, uint8_t *byte) {
    uint8_t value = *byte;

    if (value == J2A_SOF || value == J2A_SOS) {
        j2a_rx.checksum = 0;
        j2a_rx.count = 0;
        j2a_rx.state = value == J2A_SOF ? SEQ : IDLE;
        ended(state, J2A_ERR_FRAMING, J2A_SITE_MARKER);
        return false;
    }
    if (state == IDLE)
        return false;
    if (state & ESCAPED) {
        if (value == 0xFF) {
            abandon(J2A_ERR_FRAMING, J2A_SITE_ESCAPE);
            return false;
        }
        value++;
        state = (uint8_t)(state - ESCAPED);
        j2a_rx.state = state;
    } else if (value == J2A_ESC) {
        j2a_rx.state = (uint8_t)(state + ESCAPED);
        return false;
    }
    *byte = value;
    if (state == PAYLOAD)
        return true;
    if (state == CHECKSUM) {
        if (value != j2a_rx.checksum) {
            abandon(J2A_ERR_CHECKSUM, J2A_SITE_CHECKSUM);
        } else {
            j2a_rx.state = IDLE;
            j2a_rx.event = J2A_EVENT_FRAME;
        }
        return false;
    }
    if (state == SEQ) {
        j2a_rx.seq = value;
    } else if (state == OPCODE) {
        j2a_rx.opcode = value;
        value = (uint8_t)(value + J2A_CHK_OPCODE);
    } else {
        j2a_rx.length = value;
        if (value == 0)
            state++;
        value = (uint8_t)(value + J2A_CHK_LENGTH);
    }
    j2a_rx.checksum ^= value;
    j2a_rx.state = (uint8_t)(state + 1);
    return false;
}

/* Half of the time that an AVR has for a byte at 1 Mbaud is spent here. So the usual case comes first, and
 * takes as few steps as it can. */
void j2a_rx_parse(uint8_t byte) {
    const uint8_t state = j2a_rx.state;
    uint8_t count;

    if ((state != PAYLOAD || byte == J2A_SOF || byte == J2A_SOS || byte == J2A_ESC) && !other(state, &byte))
        return;
    count = j2a_rx.count;
    j2a_rx.checksum ^= byte;
#if J2A_ROOM < J2A_MAX_PAYLOAD
    if (count < J2A_ROOM)
#endif
        j2a_rx.payload[count] = byte;
    j2a_rx.count = ++count;
    if (count == j2a_rx.length)
        j2a_rx.state = CHECKSUM;
}

bool j2a_rx_byte(uint8_t byte) {
    if (j2a_rx.event != J2A_EVENT_NONE)
        return false;
    j2a_rx.fed = true;
    j2a_rx_parse(byte);
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
