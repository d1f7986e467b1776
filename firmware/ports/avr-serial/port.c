/* AVR with the newer USART (ATmega48 to 328, 16U4, 32U4, 640 to 2560, 164 to 1284): the link is USART
 * J2A_USART, 8N1 at BAUD. The receive interrupt fills a ring. Timer 1 runs freely and is both clocks. Uses
 * no other hardware.
 * The ring is not that of ports/common/board_port.c on purpose: on an ATmega328P this port is 142 bytes of flash
 * smaller than a board.c on top of that one, received by interrupt (888 to 1030 with J2A_WITH_MAPPING, MANY, SIF and
 * CLOCK 0; 64 with the clock), and no interrupt of a millisecond counter delays the one that receives.
 * Rule: after a loss nothing is stored until the ring is empty and the parser knows of the loss, so
 * that bytes from before and after it never end up in one frame. */
#include <avr/interrupt.h>
#include <avr/io.h>

#include "avr_clock.h"
#include "j2a_port.h"
#include "usart.h"

#define DIVIDER ((F_CPU + 4 * BAUD) / (8 * BAUD))
#define ERROR_PER_MILLE (((F_CPU / 8 > DIVIDER * BAUD ? F_CPU / 8 - DIVIDER * BAUD \
                                                      : DIVIDER * BAUD - F_CPU / 8) * 1000) / (F_CPU / 8))
/* A character must pass well within the byte timeout, and the fastest is F_CPU / 16, because receiving
 * takes about 140 cycles. The data sheet recommends 1.5 %. 2.2 let 115200 in, which is off by 2.1 at 16 MHz:
 * every host has it, the two sides may differ by about 4, and USB adapters are exact. */
#if F_CPU < 1000000
#error "F_CPU (make FREQ=) must be 1000000 or more: the clock in Hz"
#elif BAUD < 2400 || BAUD > F_CPU / 16
#error "BAUD must be 2400..F_CPU / 16; F_CPU / 16, / 32 and / 64 are exact"
#elif ERROR_PER_MILLE > 22
#error "BAUD: the USART is off by more than 2.2 %; give one that divides F_CPU / 8, such as F_CPU / 16, / 32 or / 64"
#endif
#if J2A_RXBUF > 255
#error "J2A_RXBUF must be 1..255"
#endif
#if J2A_TXBUF > 0
#error "this port has no transmit buffer, so J2A_TXBUF must be 0"
#endif

#define RECEIVING (_BV(BIT_RXEN) | _BV(BIT_TXEN) | _BV(BIT_RXCIE))

/* One place stays free, so that full and empty differ. */
static volatile uint8_t rx[J2A_RXBUF + 1];
static volatile uint8_t rx_head, rx_tail;
static volatile bool lost;
static uint16_t overruns;

/* Downwards, because a comparison with 0 is shorter. */
static inline uint8_t after(uint8_t index) {
    if (index == 0)
        index = (uint8_t)(J2A_RXBUF + 1);
    return (uint8_t)(index - 1);
}

void j2a_port_init(int argc, char **argv) {
    (void)argc;
    (void)argv;
    /* All of it: a boot loader may leave other values than a reset does. */
    UBRRnH = (DIVIDER - 1) >> 8;
    UBRRnL = (DIVIDER - 1) & 0xFF;
    UCSRnA = _BV(BIT_U2X);
    UCSRnC = BIT_8N1;
    UCSRnB = RECEIVING;
    avr_clock_start();
    sei();
}

ISR(USARTn_RX_vect) {
    const uint8_t status = UCSRnA; /* before the byte: reading that moves the flags on */
    const uint8_t byte = UDRn;

    if (!lost) {
        const uint8_t head = rx_head;
        const uint8_t next = after(head);
        if ((status & _BV(BIT_DOR)) || next == rx_tail) {
            lost = true;
        } else {
            rx[head] = byte;
            rx_head = next;
        }
    }
}

int16_t j2a_port_rx(void) {
    /* Read first: once it is set the ring gets no more bytes, so "empty" stays true. */
    const bool after_loss = lost;
    const uint8_t tail = rx_tail;

    if (tail != rx_head) {
        rx_tail = after(tail);
        return rx[tail];
    }
    if (after_loss) {
        j2a_rx_lost();
        overruns++;
        lost = false;
    }
    return -1;
}

/* Waits for the transmitter, which itself holds two bytes: nothing else would be done meanwhile. */
void j2a_port_tx(uint8_t byte) {
    loop_until_bit_is_set(UCSRnA, BIT_UDRE);
    UDRn = byte;
}

uint16_t j2a_port_overruns(void) {
    return overruns;
}

void j2a_port_idle(void) {
}
