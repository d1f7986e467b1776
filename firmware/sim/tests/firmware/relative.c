/* For an ATmega32U2: uses RAM and flash that an AT90USB162 does not have, and says what it found there. */
#include <avr/io.h>
#include <avr/pgmspace.h>

static volatile uint8_t ram[700];
static const uint8_t PROGMEM far[17000] = {[16999] = 0x5a};

int main(void) {
    UBRR1 = 16; /* 115200 */
    UCSR1A = _BV(U2X1);
    UCSR1B = _BV(RXEN1) | _BV(TXEN1);
    ram[699] = 0xa5;
    UDR1 = ram[699];
    loop_until_bit_is_set(UCSR1A, UDRE1);
    UDR1 = pgm_read_byte(&far[16999]);
    for (;;) {
    }
}
