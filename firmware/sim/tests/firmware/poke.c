/* Reads and writes registers as it is told through its variables, so that a test can be the firmware. */
#include <avr/interrupt.h>
#include <avr/io.h>

volatile uint8_t go, value, turns, serve, gen_entries, gen_seen, com_entries, com_seen;
volatile uint8_t *volatile address;

ISR(USB_GEN_vect)
{
    gen_seen = UDINT;
    if (serve)
        UDINT = 0;
    else if (gen_entries == 2)
        UDIEN = 0;
    gen_entries++;
}

ISR(USB_COM_vect)
{
    uint8_t selected = UENUM;
    com_seen = UEINT;
    if (com_entries++ == 2)
        for (UENUM = 0; UENUM < 5; UENUM++)
            UEIENX = 0;
    UENUM = selected;
}

/* Writes `value`, and 0 so many times three cycles and one more after it. */
static void pulse(void)
{
    uint8_t n = turns;
    __asm__ volatile("st %a1, %2\n1: dec %0\n brne 1b\n st %a1, __zero_reg__"
                     : "+r"(n) : "e"(address), "r"(value) : "memory");
}

int main(void)
{
    sei();
    for (;;) {
        if (!go)
            continue;
        if (go == 1)
            *address = value;
        else if (go == 3)
            pulse();
        else
            value = *address;
        go = 0;
    }
}
