/* Writes three bytes without looking at UDRE, waits for TXC, then marks what the flags were. */
#include "uart.h"

volatile uint8_t after_first, after_second;

int main(void) {
    uart_init(0);
    UDR0 = 'a';
    after_first = UCSR0A;
    UDR0 = 'b';
    after_second = UCSR0A;
    UDR0 = 'c';
    while (!(UCSR0A & _BV(TXC0))) {
    }
    GPIOR0 = 1;
    GPIOR0 = 0;
    for (;;) {
    }
}
