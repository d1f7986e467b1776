/* Sends back what comes, by interrupts, and sleeps meanwhile. Each handler moves one byte. */
#include "uart.h"

static volatile uint8_t ring[256], head, tail;
volatile uint16_t rx_entries, udre_entries;

ISR(USART_RX_vect) {
    rx_entries++;
    ring[head++] = UDR0;
    UCSR0B |= _BV(UDRIE0);
}

ISR(USART_UDRE_vect) {
    udre_entries++;
    if (tail == head)
        UCSR0B &= ~_BV(UDRIE0);
    else
        UDR0 = ring[tail++];
}

int main(void) {
    uart_init(_BV(RXCIE0));
    set_sleep_mode(SLEEP_MODE_IDLE);
    sei();
    for (;;)
        sleep_mode();
}
