/* A Raspberry Pi Pico (RP2040), UART0 on GPIO0 (TX) and GPIO1 (RX): bytes flow from the UART's FIFO of 32
 * into the ring by interrupt, and back by its transmit FIFO. Everything runs at the 12 MHz of the crystal, and
 * the TIMER is the clock. Run in the emulator of ../../verify/emulators/rp2040; not yet on a board, for which the .uf2 is.
 * Rules: an interrupt handler and the main loop share no variable; a read of UART_DATA takes a byte out of the
 * FIFO, together with the flag that bytes were lost before it, so only board_lost() reads it. */
#include "board.h"
#include "cortex_m.h"
#include "rp2040.h"

#define REGISTER CORTEX_M_REG

#define CLOCK_HZ 12000000u
/* The UART divides by 16 and by this many 64ths: off by 0.8 % at most. */
#define DIVIDER_64 ((CLOCK_HZ * 4 + BAUD / 2) / BAUD)
/* A character must pass well within the byte timeout. */
#if BAUD < 2400 || BAUD > CLOCK_HZ / 16
#error "BAUD must be 2400 or more, and 12 MHz of clock allow up to 750000"
#endif
/* With FIFOs a byte is seen up to 32 bit times late, and so a pause of 9 ms within a frame seems longer. At low
 * rates it would be taken for the end of the frame; there the UART holds one byte, which lasts long enough. */
#define LINE (BAUD < 50000 ? UART_8_BITS : UART_8_BITS | UART_FIFOS)

static uint8_t received;

static void take_out_of_reset(uint32_t blocks) {
    REGISTER(RESETS_RESET + ATOMIC_CLEAR) = blocks;
    while (~REGISTER(RESETS_DONE) & blocks) {
    }
}

/* The crystal for all but USB: clk_ref, clk_sys, which follows it, clk_peri for the UART, and a tick of 1 us. */
static void start_clocks(void) {
    REGISTER(XOSC_STARTUP) = CLOCK_HZ / 1000 / 256 + 1; /* 1 ms, in units of 256 cycles */
    REGISTER(XOSC_CTRL) = XOSC_ENABLE_1_TO_15_MHZ;
    while (!(REGISTER(XOSC_STATUS) & XOSC_STABLE)) {
    }
    REGISTER(CLK_REF_CTRL) = CLK_REF_FROM_XOSC;
    while (!(REGISTER(CLK_REF_SELECTED) & 1u << CLK_REF_FROM_XOSC)) {
    }
    REGISTER(CLK_PERI_CTRL) = CLK_PERI_ENABLE_FROM_SYS;
    REGISTER(WATCHDOG_TICK) = WATCHDOG_TICK_ENABLE | CLOCK_HZ / 1000000;
}

/* An empty FIFO withdraws the request. */
static void uart0_received(void) {
    while (!(REGISTER(UART_FLAGS) & UART_RX_EMPTY))
        port_receive();
}

static void millisecond(void) {
    REGISTER(TIMER_INTERRUPT) = TIMER_ALARM0;
}

CORTEX_M_INTERRUPTS = {[IRQ_TIMER0] = millisecond, [IRQ_UART0] = uart0_received};

void board_init(void) {
    start_clocks();
    take_out_of_reset(RESET_IO_BANK0 | RESET_PADS_BANK0 | RESET_TIMER | RESET_UART0);
    REGISTER(UART_DIVIDER) = DIVIDER_64 >> 6;
    REGISTER(UART_FRACTION) = DIVIDER_64 & 63;
    REGISTER(UART_LINE) = LINE; /* takes the divider over, too */
    REGISTER(UART_LEVELS) = 0;  /* interrupt at 4 bytes, or 32 bit times after the last one */
    REGISTER(UART_INTERRUPTS) = UART_RX | UART_RX_TIMEOUT;
    REGISTER(PADS_GPIO1 + ATOMIC_CLEAR) = PADS_PULL_DOWN;
    REGISTER(PADS_GPIO1 + ATOMIC_SET) = PADS_PULL_UP; /* with nothing connected no bytes come */
    REGISTER(GPIO0_CTRL) = GPIO_FUNCTION_UART;
    REGISTER(GPIO1_CTRL) = GPIO_FUNCTION_UART;
    REGISTER(UART_CONTROL) = UART_ENABLE | UART_TX_ENABLE | UART_RX_ENABLE;
    REGISTER(TIMER_INTERRUPTS) = TIMER_ALARM0;
    cortex_m_enable(IRQ_UART0);
    cortex_m_enable(IRQ_TIMER0);
}

bool board_lost(void) {
    const uint32_t data = REGISTER(UART_DATA);
    received = (uint8_t)data;
    return data & UART_OVERRUN;
}

uint8_t board_read(void) {
    return received;
}

bool board_can_write(void) {
    return !(REGISTER(UART_FLAGS) & UART_TX_FULL);
}

void board_write(uint8_t byte) {
    REGISTER(UART_DATA) = byte;
}

/* Both halves, read again when the lower one has wrapped in between. The registers that keep the upper half meanwhile keep
 * it for one reader only, and an interrupt may be another. */
uint64_t board_us(void) {
    uint32_t high;
    uint32_t low;
    do {
        high = REGISTER(TIMER_RAW_HIGH);
        low = REGISTER(TIMER_RAW_LOW);
    } while (high != REGISTER(TIMER_RAW_HIGH));
    return (uint64_t)high << 32 | low;
}

/* Sleeps until an interrupt, or a millisecond. One since the last sleep has left its mark in the processor,
 * and WFE goes on at once. */
void board_idle(void) {
    REGISTER(TIMER_ALARM) = REGISTER(TIMER_RAW_LOW) + 1000;
    __asm__ volatile("wfe");
}
