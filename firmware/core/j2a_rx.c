/* The push parser. Bytes of the link flow in one by one; out comes an event: a frame whose
 * checksum is right, or the code of an error to be sent. Rules: it never waits and sends nothing, and j2a_rx_parse()
 * does not look at the clock, which is not set up yet when the self-test calls it.
 * A raw marker always ends the frame in work; a raw SOF always starts a new one. Bytes outside a
 * frame are skipped. An error is only reported when the frame's seq was received. */
#include "j2a_internal.h"

enum { IDLE, SEQ, OPCODE, LENGTH, PAYLOAD, CHECKSUM, ESCAPED = 0x80 };

j2a_rx_t j2a_rx_of[J2A_LINKS];
#if J2A_LINKS > 1
uint8_t j2a_failure;
uint8_t j2a_link;
#endif

/* Gives the frame up, and reports it if its seq had come. next: what the next byte is. Everybody calls this
 * as the last act: then no registers need saving. */
static J2A_NOINLINE void abandon(uint8_t next, uint8_t code, uint8_t site) {
    j2a_rx_t *const rx = j2a_served();
    const uint8_t state = rx->state;
    rx->state = next;
    if ((uint8_t)(state & ~ESCAPED) > SEQ)
        rx->event = j2a_error(code, site, &rx->length, rx->payload);
}

/* Takes a byte of the frame that is none of the payload, without its escape. */
static void field(j2a_rx_t *rx, uint8_t state, uint8_t byte) {
    if (state == CHECKSUM) {
        if (byte != rx->checksum) {
            abandon(IDLE, J2A_ERR_CHECKSUM, J2A_SITE_CHECKSUM);
        } else {
            rx->state = IDLE;
            rx->event = J2A_EVENT_FRAME;
        }
        return;
    }
    if (state == SEQ) {
        rx->seq = byte;
    } else if (state == OPCODE) {
        rx->opcode = byte;
        byte = (uint8_t)(byte + J2A_CHK_OPCODE);
    } else {
        rx->length = byte;
        if (byte == 0)
            state++;
        byte = (uint8_t)(byte + J2A_CHK_LENGTH);
    }
    rx->checksum ^= byte;
    rx->state = (uint8_t)(state + 1);
}

/* A third of the time that an AVR has for a byte at 1 Mbaud is spent here. So a byte of the payload has
 * the shortest way. */
J2A_NOINLINE void j2a_rx_parse(uint8_t byte) {
    j2a_rx_t *const rx = j2a_served();
    uint8_t state = rx->state;
    uint8_t count;

    if (byte == J2A_SOF || byte == J2A_SOS) {
        rx->checksum = 0;
        rx->count = 0;
        abandon(byte == J2A_SOF ? SEQ : IDLE, J2A_ERR_FRAMING, J2A_SITE_MARKER);
        return;
    }
    if (state != PAYLOAD || byte == J2A_ESC) {
        if (state == IDLE)
            return;
        if (state & ESCAPED) {
            if (byte == 0xFF) {
                abandon(IDLE, J2A_ERR_FRAMING, J2A_SITE_ESCAPE);
                return;
            }
            byte++;
            state = (uint8_t)(state - ESCAPED);
            rx->state = state;
        } else if (byte == J2A_ESC) {
            rx->state = (uint8_t)(state + ESCAPED);
            return;
        }
        if (state != PAYLOAD) {
            field(rx, state, byte);
            return;
        }
    }
    count = rx->count;
    rx->checksum ^= byte;
#if J2A_ROOM < J2A_MAX_PAYLOAD
    if (count < J2A_ROOM)
#endif
        rx->payload[count] = byte;
    rx->count = ++count;
    if (count == rx->length)
        rx->state = CHECKSUM;
}

#if J2A_PORT_SHARES_ROOM
uint8_t *j2a_rx_room(void) {
    j2a_rx_t *const rx = j2a_served();
    return rx->event == J2A_EVENT_NONE && (uint8_t)(rx->state & ~ESCAPED) < PAYLOAD ? rx->payload : 0;
}
#endif

bool j2a_rx_byte(uint8_t byte) {
    j2a_rx_t *const rx = j2a_served();
    if (rx->event != J2A_EVENT_NONE)
        return false;
    j2a_rx_parse(byte);
#if J2A_WITH_SYNC
    if (rx->event == J2A_EVENT_FRAME)
        j2a_received_us = j2a_port_time_us();
#endif
    rx->last_ticks = j2a_port_ticks();
    return true;
}

void j2a_rx_lost(void) {
    abandon(IDLE, J2A_ERR_FRAMING, J2A_SITE_LOST);
}

void j2a_rx_timeout(void) {
    abandon(IDLE, J2A_ERR_TIMEOUT, J2A_SITE_TIMEOUT);
}
