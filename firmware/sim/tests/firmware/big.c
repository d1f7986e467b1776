/* More flash (6 KiB) and RAM (600 bytes) than the smallest parts have. */
#include "uart.h"
#include <avr/pgmspace.h>

const uint8_t filler[6000] PROGMEM = {1};
volatile uint8_t ram[600];

int main(void) {
    uart_init(0);
    for (;;)
        put(ram[get()] + pgm_read_byte(&filler[get()]));
}
