/* Reads nothing for PAUSE timer ticks of 64 us, then all that is there, with its status. */
#include "uart.h"

#ifndef PAUSE
#define PAUSE 100
#endif

volatile uint8_t count, bytes[8], status[8];

int main(void) {
    uart_init(0);
    TCCR1B = _BV(CS12) | _BV(CS10);
    while (TCNT1 < PAUSE) {
    }
    while (UCSR0A & _BV(RXC0)) {
        status[count] = UCSR0A;
        bytes[count++] = UDR0;
    }
    put('!');
    for (;;)
        put(get());
}
