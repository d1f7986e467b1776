/* The board is a process: its UART is standard input and output, its counter the system's clock. */
#define _POSIX_C_SOURCE 200809L

#include <poll.h>
#include <stdlib.h>
#include <time.h>
#include <unistd.h>

#include "board.h"

static bool has_byte_within(int timeout_ms) {
    struct pollfd input = {STDIN_FILENO, POLLIN, 0};
    return poll(&input, 1, timeout_ms) > 0;
}

void board_init(void) {
}

bool board_has_byte(void) {
    return has_byte_within(0);
}

bool board_lost(void) {
    return false; /* a pipe loses nothing */
}

uint8_t board_read(void) {
    uint8_t byte;
    if (read(STDIN_FILENO, &byte, 1) != 1)
        exit(EXIT_SUCCESS); /* the host is gone */
    return byte;
}

bool board_can_write(void) {
    return true;
}

void board_write(uint8_t byte) {
    if (write(STDOUT_FILENO, &byte, 1) != 1)
        exit(EXIT_SUCCESS);
}

uint32_t board_ms(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint32_t)now.tv_sec * 1000 + (uint32_t)(now.tv_nsec / 1000000);
}

void board_idle(void) {
    has_byte_within(1); /* sleeps for a millisecond, or until a byte comes */
}
