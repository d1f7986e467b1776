/* After one byte: an instruction that does not exist (i), a jump out of the program (j), sleep with
 * interrupts off (s), a watchdog reset (w). Otherwise counts its starts and says the number. */
#include "uart.h"

uint8_t starts __attribute__((section(".noinit")));
volatile uint8_t table[] = {1, 2, 3};

int main(void) {
    if (MCUSR & _BV(WDRF))
        starts++;
    MCUSR = 0;
    wdt_disable();
    uart_init(0);
    put('0' + starts);
    switch (get()) {
    case 'i':
        asm volatile(".word 0x0001");
        break;
    case 'j':
        ((void (*)(void))0x3f00)();
        break;
    case 's':
        sleep_mode();
        break;
    case 'w':
        wdt_enable(WDTO_15MS);
        break;
    }
    for (;;) {
    }
}
