/* Reads bytes of the signature row and of the flash, as told by `from` and `wait`. The interrupt shows that its
 * vector, which lies where the row is read, is intact. */
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/pgmspace.h>

volatile uint8_t go, from, wait, in_row, in_flash, after, ticks;

ISR(TIMER0_OVF_vect) { ticks++; }

/* `wait` instructions of one cycle, 0 to 3, lie between the two. */
#define READ(NOPS)                                                                                        \
    __asm__ volatile("out %2, %3\n" NOPS " lpm %0, Z\n in %1, %2"                                          \
                     : "=&r"(byte), "=&r"(state) : "I"(_SFR_IO_ADDR(SPMCSR)), "r"(0x21), "z"(at))

int main(void)
{
    TCCR0B = _BV(CS00);
    TIMSK0 = _BV(TOIE0);
    sei();
    for (;;) {
        uint8_t byte, state;
        uint16_t at = from;
        if (!go)
            continue;
        cli();
        if (wait == 0)
            READ("");
        else if (wait == 1)
            READ("nop\n");
        else if (wait == 2)
            READ("nop\n nop\n");
        else
            READ("nop\n nop\n nop\n");
        sei();
        in_row = byte;
        after = state;
        in_flash = pgm_read_byte(at);
        go = 0;
    }
}
