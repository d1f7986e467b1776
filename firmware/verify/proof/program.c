/* All of the core behind the parser, called for ever: arbitrary frames and errors come from the
 * parser, functions of the application return whatever they may, SIFs and debug text are sent at any
 * time. The parser itself is a model here, of which nothing is known but its contracts; that the real
 * one keeps them is shown from parser.c. */
#include "any.h"
#include "contracts.h"
#include "j2a_functions.h"

volatile uint8_t any_u8;
volatile uint16_t any_u16;
volatile uint32_t any_u32;

j2a_rx_t j2a_rx_of[J2A_LINKS];
#if J2A_LINKS > 1
uint8_t j2a_link;
#endif

static uint8_t elsewhere[J2A_MAX_PAYLOAD];
static char text[9];

/* ---------------------------------------------------------------------- the parser's model --- */

/* The parser's own fields hold this, so that a write by anybody else is seen; the length is its own while
 * nothing waits. */
enum { MINE = 0xA5 };

/* Directly after a loss the parser is between frames, and takes one byte even while the error waits. */
static bool after_loss;

static enum { NOTHING, FRAME, ERROR } waits; /* what the parser left */

static void see_what_waits(void) {
    waits = j2a_rx.event == J2A_EVENT_NONE ? NOTHING : j2a_rx.event == J2A_EVENT_FRAME ? FRAME : ERROR;
    //@ split waits;
}

static void own(void) {
    see_what_waits();
    j2a_rx.state = j2a_rx.checksum = j2a_rx.count = MINE;
    j2a_rx.length = waits == NOTHING ? MINE : waits == FRAME ? any_u8 : 2;
}

static void owned(void) {
    //@ check j2a_rx.state == MINE && j2a_rx.checksum == MINE && j2a_rx.count == MINE;
    if (j2a_rx.event == J2A_EVENT_NONE) {
        //@ check j2a_rx.length == MINE;
    }
}

static uint8_t any_error(void) {
    return any_bool ? J2A_ERR_CHECKSUM : J2A_ERR_FRAMING;
}

/* Every byte of the payload may have any value from the start, so it need not be written here. */
void j2a_rx_parse(uint8_t byte) {
    (void)byte;
    owned();
    if (j2a_rx.event == J2A_EVENT_NONE) {
        j2a_rx.seq = any_u8;
        j2a_rx.opcode = any_u8;
        if (any_bool)
            j2a_rx.event = any_bool ? J2A_EVENT_FRAME : any_error();
        own();
    } else {
        //@ check after_loss == 1;
    }
    after_loss = false;
}

bool j2a_rx_byte(uint8_t byte) {
    if (j2a_rx.event != J2A_EVENT_NONE)
        return false;
    j2a_rx_parse(byte);
    j2a_rx.last_ticks = any_u16;
    return true;
}

void j2a_rx_lost(void) {
    owned();
    if (j2a_rx.event == J2A_EVENT_NONE && any_bool)
        j2a_rx.event = J2A_ERR_FRAMING;
    own();
    after_loss = true;
}

void j2a_rx_timeout(void) {
    owned();
    if (any_bool)
        j2a_rx.event = J2A_ERR_TIMEOUT;
    own();
}

/* ---------------------------------------------------------------------- the sender's model --- */

static uint8_t replies;

void j2a_send(uint8_t start, uint8_t seq, uint8_t opcode, uint8_t length, const uint8_t *payload) {
#if J2A_WITH_BOOT
    if (start == J2A_SOS) {
        //@ check length == J2A_BOOT_BYTES && \initialized(payload + (0 .. J2A_BOOT_BYTES - 1));
        return;
    }
#endif
    //@ check start == J2A_SOF;
    (void)seq;
    (void)opcode;
    (void)length;
    (void)payload;
    replies++;
}

#if J2A_WITH_SIF
void j2a_send_sif(uint8_t opcode, uint8_t length, const uint8_t *payload) {
    (void)opcode;
    (void)length;
    (void)payload;
}
#endif

#if J2A_WITH_SELFTEST
/* ---------------------------------------------------------------------- the self-test's model --- */

/* Fills up to the end; that the real one stays inside is shown from selftest.c. */
void j2a_selftest_property(size_t at, uint32_t offset, bool *is_last, uint8_t *length, uint8_t *data) {
    (void)at;
    (void)offset;
    //@ check *length <= J2A_ROOM_MANY && \valid(data + (0 .. J2A_ROOM_MANY - 1));
    while (*length < J2A_ROOM_MANY && any_bool)
        data[(*length)++] = any_u8;
    *is_last = any_bool;
}
#endif

/* ------------------------------------------------------------------------------ the port ------ */

int16_t j2a_port_rx(void) {
    const bool lost = any_bool;
    after_loss = false;
    //@ split lost;
    if (lost)
        j2a_rx_lost();
    return any_bool ? (int16_t)any_u8 : -1;
}

uint16_t j2a_port_ticks(void) {
    return any_u16;
}

/* ------------------------------------------------------------------------- the application --- */

static void write_anything(uint8_t *bytes, uint8_t count) {
    while (count--)
        bytes[count] = any_u8;
}

/* What an application may do at any time in the main context. */
static void act(void) {
    write_anything(elsewhere, sizeof elsewhere);
#if J2A_WITH_SIF
    if (any_bool)
        j2a_send_sif(any_u8, any_u8, elsewhere);
#endif
    if (any_bool) {
        uint8_t i;
        for (i = 0; i < sizeof text - 1; i++)
            text[i] = (char)any_u8;
        j2a_debug(text);
    }
}

uint8_t any_call(uint8_t *const length, uint8_t **const payload) {
    const bool points_elsewhere = any_bool;
    //@ check *length <= J2A_ROOM && *payload == &j2a_rx.payload[0];
    write_anything(*payload, J2A_ROOM);
    act();
    //@ split points_elsewhere;
    *length = any_u8;
    if (points_elsewhere)
        *payload = elsewhere;
    else
        *length = (uint8_t)(*length % (J2A_ROOM + 1u));
    return any_u8;
}

/* Leaves a part of the request, up to its last byte. */
uint8_t any_part(uint8_t *const length, uint8_t **const payload) {
    static const uint8_t firsts[] = {1, 6, J2A_ROOM / 2, J2A_ROOM - 1, J2A_ROOM};
    const uint8_t first = firsts[any_u8 % sizeof firsts];
    //@ split first;
    *length = (uint8_t)(any_u8 % (J2A_ROOM + 1u - first));
    *payload += first;
    return any_u8;
}

uint8_t any_many(bool *is_last, bool is_write, uint32_t *const offset, uint8_t *const length,
                 uint8_t **const data) {
    (void)is_write;
    //@ check *length <= J2A_ROOM_MANY && *data == &j2a_rx.payload[J2A_MANY_HEADER];
    write_anything(*data, J2A_ROOM_MANY);
    act();
    *is_last = any_bool;
    *offset = any_u32;
    *length = any_u8;
    if (any_bool)
        *data = any_bool ? elsewhere : j2a_rx.payload;
    return any_u8;
}

#if J2A_WITH_INTERFACE
#define ANY_CALL(number) \
    uint8_t any_call_##number(uint8_t *const length, uint8_t **const payload) { \
        (void)payload; \
        *length = 0; \
        return 0; \
    }
ANY_CALL(1)
ANY_CALL(2)
ANY_CALL(3)
ANY_CALL(4)
ANY_CALL(5)
ANY_CALL(6)
#endif

int main(void) {
    write_anything(j2a_rx.payload, J2A_ROOM);
    own();
    //@ loop unroll 0;
    for (;;) {
        see_what_waits();
        replies = 0;
        j2a_process();
        //@ check replies == (waits != NOTHING ? 1 : 0) && j2a_rx.event == J2A_EVENT_NONE;
        own();
        j2a_poll();
        j2a_task();
        own();
        act();
        if (any_bool) { /* a port that pushes */
            j2a_rx_byte(any_u8);
            j2a_rx_byte(any_u8);
        }
        if (any_bool)
            j2a_rx_lost();
    }
}
