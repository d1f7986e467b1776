/* Spans whose lengths follow from the data sheet; the third has two interrupts in it. */
#include "uart.h"

#define NOPS_10 asm volatile("nop\nnop\nnop\nnop\nnop\nnop\nnop\nnop\nnop\nnop")
#define NOPS_100 NOPS_10; NOPS_10; NOPS_10; NOPS_10; NOPS_10; NOPS_10; NOPS_10; NOPS_10; NOPS_10; NOPS_10

ISR(TIMER1_COMPA_vect, ISR_NAKED) {
    asm volatile("reti");
}

static void __attribute__((noinline)) use_stack(void) {
    volatile uint8_t block[100];
    for (uint8_t i = 0; i < sizeof block; i++)
        block[i] = i;
}

int main(void) {
    uart_init(0);
    GPIOR0 = 1;
    GPIOR0 = 0;
    GPIOR0 = 2;
    NOPS_100;
    GPIOR0 = 0;
    TCCR1B = _BV(WGM12);
    OCR1A = 50;
    TIMSK1 = _BV(OCIE1A);
    sei();
    TCCR1B = _BV(WGM12) | _BV(CS10);
    GPIOR0 = 3;
    NOPS_100;
    GPIOR0 = 0;
    cli();
    use_stack();
    put('.');
    for (;;) {
    }
}
