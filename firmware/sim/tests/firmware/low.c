/* INT0 while its pin is low: 'e' enables it, 'd' disables it, each is answered by the same byte. */
#include <avr/interrupt.h>

#include "uart.h"

EMPTY_INTERRUPT(INT0_vect)

int main(void)
{
    uart_init(0);
    EICRA = 0;
    sei();
    for (;;) {
        uint8_t byte = get();
        EIMSK = byte == 'e' ? _BV(INT0) : 0;
        put(byte);
    }
}
