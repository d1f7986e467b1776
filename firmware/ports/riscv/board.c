/* A 32-bit RISC-V, QEMU's machine `virt`: bytes flow from the FIFO of its UART into the ring by interrupt,
 * and the counter mtime is the clock.
 * Rule: reading the UART's status clears the overrun flag, so who reads it keeps the flag in `overrun`, and
 * does both with interrupts off. */
#include "board.h"
#include "virt.h"

#define DIVIDER ((UART_CLOCK_HZ + 8 * BAUD) / (16 * BAUD))
#if BAUD < 2400
#error "BAUD must be 2400 or more: a character must pass well within the byte timeout"
#elif UART_CLOCK_HZ != 16 * DIVIDER * BAUD
#error "BAUD: not one that the UART has exactly; take 230400, 115200, 57600, 38400, 19200 or 9600"
#endif
/* Bytes that are fewer than 8 are seen 4 characters late, and so a pause of 9 ms within a frame seems longer. At low
 * rates it would be taken for the end of the frame; there each byte is announced. */
#define FIFO (BAUD < 50000 ? FIFO_CLEARED_1 : FIFO_CLEARED_8)

static bool overrun;
static volatile bool received; /* since the last board_idle() */
static uint64_t start; /* of mtime */

static void interrupts_off(void) {
    __asm__ volatile("csrc mstatus, %0" : : "i"(MSTATUS_MIE) : "memory");
}

static void interrupts_on(void) {
    __asm__ volatile("csrs mstatus, %0" : : "i"(MSTATUS_MIE) : "memory");
}

static uint8_t status(void) {
    const uint8_t flags = UART_STATUS;
    if (flags & STATUS_OVERRUN)
        overrun = true;
    return flags;
}

/* Both halves, read again when the lower one has wrapped in between. */
static uint64_t mtime(void) {
    uint32_t high;
    uint32_t low;
    do {
        high = MTIME_HIGH;
        low = MTIME;
    } while (high != MTIME_HIGH);
    return (uint64_t)high << 32 | low;
}

void board_init(void) {
    UART_LINE = LINE_DIVIDER;
    UART_DIVIDER_LOW = (uint8_t)DIVIDER;
    UART_DIVIDER_HIGH = (uint8_t)(DIVIDER >> 8);
    UART_LINE = LINE_8N1;
    UART_FIFO = FIFO;
    UART_INTERRUPTS = INTERRUPT_RECEIVED;
    PLIC_PRIORITY_UART = 1;
    PLIC_ENABLE = 1u << UART_IRQ;
    start = mtime();
    __asm__ volatile("csrw mie, %0" : : "r"(MIE_EXTERNAL));
    interrupts_on();
}

/* Takes the UART's interrupt. Whatever else ends here is a fault of the program, which then stands still, for
 * a debugger to find. */
void trap(void);
__attribute__((interrupt("machine"), aligned(4))) void trap(void) {
    uint32_t cause, source;
    __asm__ volatile("csrr %0, mcause" : "=r"(cause));
    while (cause != CAUSE_EXTERNAL) {
    }
    source = PLIC_CLAIM;
    while (status() & STATUS_RECEIVED)
        port_receive();
    received = true;
    PLIC_CLAIM = source;
}

bool board_lost(void) {
    const bool lost = overrun;
    overrun = false;
    return lost;
}

uint8_t board_read(void) {
    return UART_DATA;
}

bool board_can_write(void) {
    bool can;
    interrupts_off();
    can = status() & STATUS_CAN_WRITE;
    interrupts_on();
    return can;
}

void board_write(uint8_t byte) {
    UART_DATA = byte;
}

/* Keeps nothing, because an interrupt may ask, too. Divides digit by digit of 16 bits: a division of 64 needs a library. */
uint64_t board_us(void) {
    const uint64_t passed = mtime() - start;
    const uint32_t high = (uint32_t)(passed >> 32);
    const uint32_t middle = high % MTIME_PER_US << 16 | ((uint32_t)passed >> 16);
    const uint32_t low = middle % MTIME_PER_US << 16 | ((uint32_t)passed & 0xFFFF);
    return (uint64_t)(high / MTIME_PER_US) << 32 | (uint64_t)(middle / MTIME_PER_US) << 16 | low / MTIME_PER_US;
}

/* Sleeps until a byte comes, or a millisecond, unless one has come since the last call. With interrupts off
 * none slips in between the question and the sleep, and yet it ends the sleep. */
void board_idle(void) {
    interrupts_off();
    if (!received) {
        const uint64_t then = mtime() + MTIME_PER_US * 1000;
        MTIMECMP_HIGH = 0xFFFFFFFF; /* never, while only one half is new */
        MTIMECMP = (uint32_t)then;
        MTIMECMP_HIGH = (uint32_t)(then >> 32);
        __asm__ volatile("csrs mie, %0\n\twfi\n\tcsrc mie, %0" : : "r"(MIE_TIMER));
    }
    received = false;
    interrupts_on();
}
