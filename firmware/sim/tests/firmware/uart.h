/* USART0 at BAUD in the FORMAT (UCSR0C) given on the command line; 8N1 when none is. */
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>
#include <avr/wdt.h>

#ifndef BAUD
#define BAUD 115200
#endif
#ifndef FORMAT
#define FORMAT 0x06
#endif

static inline void uart_init(uint8_t control_b) {
    UBRR0 = (F_CPU + 4UL * BAUD) / (8UL * BAUD) - 1;
    UCSR0A = _BV(U2X0);
    UCSR0C = FORMAT;
    UCSR0B = control_b | _BV(RXEN0) | _BV(TXEN0);
}

static inline void put(uint8_t byte) {
    while (!(UCSR0A & _BV(UDRE0))) {
    }
    UDR0 = byte;
}

static inline uint8_t get(void) {
    while (!(UCSR0A & _BV(RXC0))) {
    }
    return UDR0;
}
