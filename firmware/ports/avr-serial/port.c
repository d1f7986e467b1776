/* ATmega328P at 16 MHz: the link is USART0, 8N1 at BAUD. Interrupts move the bytes between the USART
 * and two rings; timer 1 runs freely and is both clocks. Uses no other hardware.
 * Rule: after a loss nothing is stored until the ring is empty and the parser knows of the loss, so
 * that bytes from before and after it never end up in one frame. */
#include <avr/interrupt.h>
#include <avr/io.h>
#include <util/atomic.h>

#include "j2a_port.h"

#define DIVIDER ((F_CPU + 4 * BAUD) / (8 * BAUD))
#define ERROR_PER_MILLE (((F_CPU / 8 > DIVIDER * BAUD ? F_CPU / 8 - DIVIDER * BAUD \
                                                      : DIVIDER * BAUD - F_CPU / 8) * 1000) / (F_CPU / 8))
/* A character must pass well within the byte timeout, and a byte takes 156 cycles to receive.
 * The data sheet recommends 1.5 %. 2.2 let 115200 in, which is off by 2.1: every host has it, the two
 * sides may differ by about 4, and USB adapters are exact. */
#if BAUD < 2400 || BAUD > 1000000
#error "BAUD must be 2400..1000000; at 16 MHz 250000, 500000 and 1000000 are exact"
#elif ERROR_PER_MILLE > 22
#error "BAUD: the USART is off by more than 2.2 %; take 115200, or exactly 250000, 500000, 1000000"
#endif
#if J2A_RXBUF < 1 || J2A_RXBUF > 255 || J2A_TXBUF < 1 || J2A_TXBUF > 255
#error "J2A_RXBUF and J2A_TXBUF must be 1..255"
#endif

#define RECEIVING (_BV(RXEN0) | _BV(TXEN0) | _BV(RXCIE0))

/* One place stays free, so that full and empty differ. */
static volatile uint8_t rx[J2A_RXBUF + 1], tx[J2A_TXBUF + 1];
static volatile uint8_t rx_head, rx_tail, tx_head, tx_tail;
static volatile bool lost;
static uint16_t overruns;
static uint32_t timer_overflows; /* each 32.768 ms: enough for 4.4 years */

static inline uint8_t after(uint8_t index, uint8_t last) {
    return index == last ? 0 : (uint8_t)(index + 1);
}

void j2a_port_init(int argc, char **argv) {
    (void)argc;
    (void)argv;
    /* All of it: a boot loader may leave other values than a reset does. */
    UBRR0 = DIVIDER - 1;
    UCSR0A = _BV(U2X0);
    UCSR0C = _BV(UCSZ01) | _BV(UCSZ00); /* 8N1 */
    UCSR0B = RECEIVING;
    TIMSK1 = _BV(TOIE1);
    TCCR1A = 0;
    TCCR1B = _BV(CS11); /* F_CPU / 8 */
    sei();
}

ISR(USART_RX_vect) {
    const uint8_t status = UCSR0A; /* before the byte: reading that moves the flags on */
    const uint8_t byte = UDR0;

    if (!lost) {
        const uint8_t head = rx_head;
        const uint8_t next = after(head, J2A_RXBUF);
        if ((status & _BV(DOR0)) || next == rx_tail) {
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
        rx_tail = after(tail, J2A_RXBUF);
        return rx[tail];
    }
    if (after_loss) {
        j2a_rx_lost();
        overruns++;
        lost = false;
    }
    return -1;
}

ISR(USART_UDRE_vect) {
    const uint8_t tail = tx_tail;
    if (tail == tx_head) {
        UCSR0B = RECEIVING;
    } else {
        UDR0 = tx[tail];
        tx_tail = after(tail, J2A_TXBUF);
    }
}

void j2a_port_tx(uint8_t byte) {
    const uint8_t head = tx_head;
    const uint8_t next = after(head, J2A_TXBUF);
    while (next == tx_tail) {
        if (!(SREG & _BV(SREG_I))) { /* then the ring's first byte, at "next", is sent from here */
            loop_until_bit_is_set(UCSR0A, UDRE0);
            UDR0 = tx[next];
            tx_tail = after(next, J2A_TXBUF);
        }
    }
    tx[head] = byte;
    tx_head = next;
    UCSR0B = RECEIVING | _BV(UDRIE0);
}

ISR(TIMER1_OVF_vect) {
    timer_overflows++;
}

/* Reads the timer. Returns its overflows. */
static uint32_t read_timer(uint16_t *low) {
    uint32_t high;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        *low = TCNT1;
        high = timer_overflows;
        if ((TIFR1 & _BV(TOV1)) && *low < 0x8000) /* wrapped, but its interrupt has not run yet */
            high++;
    }
    return high;
}

uint16_t j2a_port_ticks(void) {
    uint16_t low;
    const uint32_t high = read_timer(&low);
    return (uint16_t)(high << 8 | low >> 8);
}

uint64_t j2a_port_time_us(void) {
    uint16_t low;
    const uint32_t high = read_timer(&low);
    return ((uint64_t)high << 16 | low) * 8 / (F_CPU / 1000000);
}

uint16_t j2a_port_overruns(void) {
    return overruns;
}

void j2a_port_idle(void) {
}
