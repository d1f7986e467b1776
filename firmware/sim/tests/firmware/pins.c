/* What the tests of pins and ADC ask for, by a byte:
 *   t  PB1 high for 160 cycles, by this program     c  PB1 by timer 1: high at 1000, low at 3000 cycles
 *   p  pull-up on at PD4; then says its level       a  ADC channel 0..7 (next byte), result as two bytes
 *   f  free running: 4 results of channel 0         d  a differential input
 *   i  lets PC0's interrupt in for a moment; then says how many of them there were
 *   x  says PCIFR, and clears the flag of PC0
 * PD2 and PD3 interrupt: PD2's handler adds 1 to the count that 'n' tells, PD3's turns PB0. */
#include "uart.h"

static volatile uint8_t count, changes, results;

ISR(INT0_vect) {
    count++;
}

ISR(PCINT1_vect) {
    changes++;
}

ISR(INT1_vect, ISR_NAKED) {
    asm volatile("sbi %0, 0\n reti" ::"I"(_SFR_IO_ADDR(PINB)));
}

static void convert(uint8_t mux) {
    ADMUX = _BV(REFS0) | mux;
    ADCSRA = _BV(ADEN) | _BV(ADSC) | 7;
    ADMUX = 0x0f; /* of a conversion that has begun this changes nothing */
    loop_until_bit_is_clear(ADCSRA, ADSC);
    uint8_t low = ADCL;
    put(low);
    put(ADCH);
}

int main(void) {
    uart_init(0);
    DDRB = _BV(0) | _BV(1);
    EICRA = _BV(ISC00) | _BV(ISC10); /* each edge */
    EIMSK = _BV(INT0) | _BV(INT1);
    PCMSK1 = _BV(0);
    sei();
    for (;;) {
        switch (get()) {
        case 't':
            PORTB |= _BV(1);
            __builtin_avr_delay_cycles(158);
            PORTB &= ~_BV(1);
            break;
        case 'c':
            OCR1A = 999;
            TCCR1A = _BV(COM1A1) | _BV(COM1A0);
            TCCR1B = _BV(CS10);
            loop_until_bit_is_set(TIFR1, OCF1A);
            TCCR1A = _BV(COM1A1);
            OCR1A = 2999;
            PORTB |= _BV(0); /* writes the whole port */
            while (TCNT1 < 3500) {
            }
            OCR1A = 5000; /* writing it moves no edge */
            TCCR1A = 0;
            TCCR1B = 0;
            break;
        case 'p':
            PORTD |= _BV(4);
            PORTD |= _BV(5);
            put(PIND);
            break;
        case 'i':
            PCICR = _BV(PCIE1);
            __builtin_avr_delay_cycles(100);
            PCICR = 0;
            put(changes);
            break;
        case 'x':
            put(PCIFR);
            PCIFR = _BV(PCIF1);
            break;
        case 'n':
            put(count);
            break;
        case 'a':
            convert(get());
            break;
        case 'd':
            ADMUX = 8;
            convert(8);
            break;
        case 'f':
            ADMUX = _BV(REFS0) | _BV(ADLAR);
            ADCSRB = 0;
            ADCSRA = _BV(ADEN) | _BV(ADSC) | _BV(ADATE) | 6;
            for (results = 0; results < 4; results++) {
                loop_until_bit_is_set(ADCSRA, ADIF);
                ADCSRA |= _BV(ADIF);
                put(ADCH);
            }
            ADCSRA = 0;
            break;
        }
    }
}
