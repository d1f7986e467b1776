/* The sender. In: any fields and a payload of any bytes, which ends where its memory ends. Out: the
 * bytes are a start byte and stuffed fields, as many as the frame has. */
#include "any.h"
#include "contracts.h"

volatile uint8_t any_u8;
volatile uint16_t any_u16;
volatile uint32_t any_u32;

j2a_rx_t j2a_rx_of[J2A_LINKS]; /* of which the sender has the seq of SIFs */

extern const uint8_t memory[J2A_MAX_PAYLOAD];

/* What may be sent next, and how many fields were (J2A-FRAME-001, J2A-STUFF-001, J2A-STUFF-002). */
static enum { START, FIELD, ESCAPED } wire;
static uint16_t fields;

void j2a_port_tx(uint8_t byte) {
    if (wire == START) {
        //@ check byte == J2A_SOF || byte == J2A_SOS;
        wire = FIELD;
    } else if (wire == ESCAPED) {
        //@ check byte == J2A_SOF - 1 || byte == J2A_SOS - 1 || byte == J2A_ESC - 1;
        wire = FIELD;
        fields++;
    } else {
        //@ check byte != J2A_SOF && byte != J2A_SOS;
        if (byte == J2A_ESC)
            wire = ESCAPED;
        else
            fields++;
    }
}

static void all_sent(uint8_t length) {
    //@ check wire == FIELD && fields == length + 4;
    wire = START;
    fields = 0;
}

static void send(uint8_t length) {
    const uint8_t *const payload = memory + sizeof memory - length;
#if J2A_WITH_SIF
    if (any_bool)
        j2a_send_sif(any_u8, length, payload);
    else
#endif
        j2a_send(J2A_SOF, any_u8, any_u8, length, payload);
    all_sent(length);
}

int main(void) {
    send(0);
    send(1);
    send(2);
    send(3);
    send(40);
    return 0;
}
