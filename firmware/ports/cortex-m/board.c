/* A Cortex-M3 at 25 MHz, the MPS2 board with AN385, which QEMU has as mps2-an385: the links are its first
 * J2A_LINKS UARTs (CMSDK APB, 8N1 at BAUD), received by interrupt, sent by polling. SysTick is the clock
 * (ports/common/cortex_m.c), timer 0 wakes the processor each millisecond.
 *   make PORT=cortex-m && qemu-system-arm -M mps2-an385 -display none -monitor none -serial stdio \
 *       -kernel build/cortex-m/demo.elf
 * Uses no other hardware. */
#include "board.h"

#include "cortex_m.h"

#define CLOCK_HZ 25000000u
/* A character must pass well within the byte timeout; the UART divides by 16 and more, without a fraction. */
#define DIVIDER ((CLOCK_HZ + BAUD / 2) / BAUD)
#if BAUD < 2400 || BAUD > CLOCK_HZ / 16
#error "BAUD must be 2400 or more, and 25 MHz of clock allow up to 1562500"
#elif DIVIDER * BAUD > CLOCK_HZ / 1000 * 1015 || DIVIDER * BAUD < CLOCK_HZ / 1000 * 985
#error "BAUD: the UART is off by more than 1.5 %; give one that divides 25 MHz, such as 1000000, 1250000 or 1562500"
#endif

/* UART 0 is at 0x40004000, UART 1 at 0x40005000. */
#define UART_REG(link, offset) CORTEX_M_REG(0x40004000 + 0x1000 * (uint32_t)(link) + (offset))
#define UART_DATA(link) UART_REG(link, 0x00)
#define UART_STATE(link) UART_REG(link, 0x04)
#define UART_CTRL(link) UART_REG(link, 0x08)
#define UART_INTCLEAR(link) UART_REG(link, 0x0C)
#define UART_BAUDDIV(link) UART_REG(link, 0x10)
#define TIMER0_CTRL CORTEX_M_REG(0x40000000)
#define TIMER0_VALUE CORTEX_M_REG(0x40000004)
#define TIMER0_RELOAD CORTEX_M_REG(0x40000008)
#define TIMER0_INTCLEAR CORTEX_M_REG(0x4000000C)

enum {
    STATE_TX_FULL = 1 << 0,
    STATE_RX_OVERRUN = 1 << 3, /* writing a 1 clears it */
    CTRL_TX = 1 << 0,
    CTRL_RX = 1 << 1,
    CTRL_RX_INTERRUPT = 1 << 3,
    INT_RX = 1 << 1,
    TIMER_ON = 1 << 0,
    TIMER_INTERRUPT = 1 << 3,
    IRQ_TIMER0 = 8
};

static void uart_init(uint32_t number) {
    UART_BAUDDIV(number) = DIVIDER;
    UART_CTRL(number) = CTRL_TX | CTRL_RX | CTRL_RX_INTERRUPT;
    cortex_m_enable(2 * number); /* "received"; 2 * number + 1 is "sent" */
}

/* The request is cleared before the byte is read: the next byte makes a new one. */
static void uart0_received(void) {
    UART_INTCLEAR(0) = INT_RX;
#if J2A_LINKS > 1
    port_receive_from(0);
}

static void uart1_received(void) {
    UART_INTCLEAR(1) = INT_RX;
    port_receive_from(1);
#else
    port_receive();
#endif
}

static void timer0(void) {
    TIMER0_INTCLEAR = 1;
}

CORTEX_M_INTERRUPTS = {
    [0] = uart0_received,
#if J2A_LINKS > 1
    [2] = uart1_received,
#endif
    [IRQ_TIMER0] = timer0,
};

void board_init(void) {
    uint32_t number;
    cortex_m_start_clock(CLOCK_HZ);
    TIMER0_RELOAD = TIMER0_VALUE = CLOCK_HZ / 1000 - 1;
    TIMER0_CTRL = TIMER_ON | TIMER_INTERRUPT;
    cortex_m_enable(IRQ_TIMER0);
    for (number = 0; number < J2A_LINKS; number++)
        uart_init(number);
}

bool board_lost(void) {
    const bool lost = (UART_STATE(j2a_link) & STATE_RX_OVERRUN) != 0;
    if (lost)
        UART_STATE(j2a_link) = STATE_RX_OVERRUN;
    return lost;
}

uint8_t board_read(void) {
    return (uint8_t)UART_DATA(j2a_link);
}

bool board_can_write(void) {
    return (UART_STATE(j2a_link) & STATE_TX_FULL) == 0;
}

void board_write(uint8_t byte) {
    UART_DATA(j2a_link) = byte;
}

uint64_t board_us(void) {
    return cortex_m_us();
}

/* A byte that comes just before this is seen a millisecond later at the latest. */
void board_idle(void) {
    cortex_m_wait();
}
