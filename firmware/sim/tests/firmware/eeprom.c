/* Marks how long a read and a write of the EEPROM take the CPU, behind what is neither; then writes 3
 * bytes from the interrupt, which comes while no write lasts. */
#include <avr/eeprom.h>
#include <avr/interrupt.h>
#include <avr/io.h>

#define MARKED(mark, bit)                                                                                    \
    __asm__ volatile("out %0, %1\n sbi %2, %3\n sbi %2, %4\n out %0, __zero_reg__" ::"I"(_SFR_IO_ADDR(GPIOR0)), \
                     "r"(mark), "I"(_SFR_IO_ADDR(EECR)), "I"(EEMPE), "I"(bit))

volatile uint8_t entries;

ISR(EE_READY_vect)
{
    if (entries == 3) {
        EECR = 0;
        return;
    }
    EEAR = entries;
    EEDR = ++entries;
    EECR |= _BV(EEMPE);
    EECR |= _BV(EEPE);
}

int main(void)
{
    uint8_t first = 1, second = 2, third = 3;
    EEAR = 3;
    EEDR = 0xff;
    MARKED(first, EEMPE);
    MARKED(second, EERE);
    MARKED(third, EEPE);
    eeprom_busy_wait();
    EECR = _BV(EERIE);
    sei();
    for (;;) {
    }
}
