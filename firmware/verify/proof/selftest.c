/* The self-test over its own vectors, which are constants. In: a parser that says anything after each
 * byte, also what contracts.h forbids, and a sender that also sends wrong bytes, too few and too many: so
 * the ways of failure are taken too. Out: the parser's state is the first one again, and the property stays in its room. */
#define j2a_send right_send
#define j2a_send_sif right_send_sif
#include "j2a_tx.c"
#include "ext/j2a_sif.c"
#undef j2a_send
#undef j2a_send_sif
#include "any.h"
#include "numbers.h"

volatile uint8_t any_u8;
volatile uint16_t any_u16;
volatile uint32_t any_u32;

j2a_rx_t j2a_rx_of[J2A_LINKS];
#define j2a_rx (j2a_rx_of[0])

void j2a_rx_parse(uint8_t byte) {
    (void)byte;
    j2a_rx.event = any_u8;
    j2a_rx.seq = any_u8;
    j2a_rx.opcode = any_u8;
    j2a_rx.length = any_u8;
    j2a_rx.payload[any_u8 % J2A_ROOM] = any_u8;
}

bool j2a_rx_byte(uint8_t byte) {
    if (any_bool)
        return false;
    j2a_rx_parse(byte);
    return true;
}

void j2a_port_tx(uint8_t byte) {
    (void)byte;
}

/* The frame, or one byte; and perhaps another. */
void j2a_send(uint8_t start, uint8_t seq, uint8_t opcode, uint8_t length, const uint8_t *payload) {
    if (any_bool) {
        right_send(start, seq, opcode, length, payload);
        if (any_bool)
            j2a_tx_byte(start);
    } else {
        j2a_tx_byte(any_u8);
    }
}

int main(void) {
    uint8_t data[J2A_MANY_DATA];
    uint8_t length = any_u8;
    bool is_last = true;

    right_send_sif(any_u8, 0, data); /* outside of the test all goes to the link */
    j2a_selftest();
    //@ check j2a_rx.state == 0 && j2a_rx.checksum == 0;
    //@ check j2a_rx.count == 0 && j2a_rx.length == 0 && j2a_rx.event == J2A_EVENT_NONE;
    if (length > J2A_MANY_DATA)
        return 0;
    j2a_selftest_property(any_u16, any_u32, &is_last, &length, data);
    //@ check length <= J2A_MANY_DATA;
    return 0;
}
