/* A receive handler that leaves its byte alone three times; another loop keeps the core busy. */
#include "uart.h"

volatile uint8_t entries, byte;

ISR(USART_RX_vect) {
    if (++entries == 4)
        byte = UDR0;
}

int main(void) {
    uart_init(_BV(RXCIE0));
    sei();
    for (;;) {
    }
}
