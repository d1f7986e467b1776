/* Marks spans and sends bytes without end. */
#include <avr/io.h>

#ifdef UDR0
enum { ON = _BV(RXEN0) | _BV(TXEN0) };
#define UCSRA UCSR0A
#define UCSRB UCSR0B
#define UDR UDR0
#else
enum { ON = _BV(RXEN1) | _BV(TXEN1) };
#define UCSRA UCSR1A
#define UCSRB UCSR1B
#define UDR UDR1
#endif

int main(void)
{
    UCSRA = 2; /* 2 Mbit/s */
    UCSRB = ON;
    for (;;) {
        GPIOR0 = 1;
        GPIOR0 = 0;
        UDR = 'x';
    }
}
