/* ATmega328P at 16 MHz: USART0 at 250000 baud, timer 0 counts milliseconds. */
#include <avr/interrupt.h>
#include <avr/io.h>
#include <util/atomic.h>

#include "board.h"

static volatile uint32_t ms;

void board_init(void) {
    UBRR0 = 16000000UL / 16 / 250000 - 1;
    UCSR0A = 0;
    UCSR0C = _BV(UCSZ01) | _BV(UCSZ00);                       /* 8N1 */
    UCSR0B = _BV(RXEN0) | _BV(TXEN0) | BOARD_INTERRUPTS * _BV(RXCIE0);
    OCR0A = 250 - 1;                                          /* of 4 us: a millisecond */
    TCCR0A = _BV(WGM01);
    TCCR0B = _BV(CS01) | _BV(CS00);                           /* clock / 64 */
    TIMSK0 = _BV(OCIE0A);
    sei();
}

ISR(TIMER0_COMPA_vect) {
    ms++;
}

bool board_has_byte(void) {
    return UCSR0A & _BV(RXC0);
}

bool board_lost(void) {
    return UCSR0A & _BV(DOR0); /* reading the byte clears it */
}

uint8_t board_read(void) {
    return UDR0;
}

bool board_can_write(void) {
    return UCSR0A & _BV(UDRE0);
}

void board_write(uint8_t byte) {
    UDR0 = byte;
}

uint32_t board_ms(void) {
    uint32_t now = 0;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        now = ms;
    }
    return now;
}

void board_idle(void) {
}

#if BOARD_INTERRUPTS
ISR(USART_RX_vect) {
    port_receive();
}
#endif
