/* An ATmega2560 at 16 MHz, UART 0 at 125000 baud: everything is polled, the clock too.
 * Written from docs/porting.md with the example that it prints, the template and the chip's data sheet,
 * and kept as the proof that these suffice: test_naive_port.py lays this folder over a copy of the
 * template and judges the result. So nothing here is to be made better than the guide asks for. */
#include "board.h"

#include <avr/io.h>

#define TICKS_PER_MS 250u /* of timer 1, at 16 MHz / 64 */

void board_init(void) {
    UBRR0 = 7; /* 16 MHz / (16 * 125000) - 1 */
    UCSR0C = _BV(UCSZ01) | _BV(UCSZ00);
    UCSR0B = _BV(RXEN0) | _BV(TXEN0);
    TCCR1B = _BV(CS11) | _BV(CS10);
}

bool board_has_byte(void) {
    return UCSR0A & _BV(RXC0);
}

bool board_lost(void) {
    return UCSR0A & _BV(DOR0); /* reading UDR0 clears it */
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

/* Timer 1 wraps after 262 ms. */
uint32_t board_ms(void) {
    static uint32_t ms;
    static uint16_t last;
    while ((uint16_t)(TCNT1 - last) >= TICKS_PER_MS) {
        last += TICKS_PER_MS;
        ms++;
    }
    return ms;
}

void board_idle(void) {
}
