/* The board: the functions of board.h, which says what each must do. As it stands here it compiles, and
 * nothing is ever received. Fill in each place. */
#include "board.h"

void board_init(void) {
    /* FILL IN: clock, UART (8N1), millisecond counter */
}

bool board_has_byte(void) {
    return false; /* FILL IN: the "receive register not empty" flag of the UART */
}

bool board_lost(void) {
    return false; /* FILL IN: the "overrun" flag of the UART; clear it */
}

uint8_t board_read(void) {
    return 0; /* FILL IN: the receive register */
}

bool board_can_write(void) {
    return true; /* FILL IN: the "transmit register empty" flag */
}

void board_write(uint8_t byte) {
    (void)byte; /* FILL IN: the transmit register = byte */
}

uint32_t board_ms(void) {
    return 0; /* FILL IN: the millisecond counter */
}

void board_idle(void) {
    /* may stay empty */
}

/* Second step, with BOARD_INTERRUPTS 1: your receive interrupt, however your compiler spells it,
 *   void UART_IRQHandler(void) { port_receive(); }
 * and no other place in which the receive register is read. */
