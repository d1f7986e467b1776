/* Registers, bits and interrupts of the RP2040, as far as the port needs them. REGISTER() is in board.c. */
#ifndef RP2040_H
#define RP2040_H

/* Written at these distances, the bits that are 1 are set or cleared, and the others stay. */
#define ATOMIC_SET 0x2000u
#define ATOMIC_CLEAR 0x3000u

#define RESETS_RESET 0x4000C000u
#define RESETS_DONE 0x4000C008u
#define RESET_IO_BANK0 (1u << 5)
#define RESET_PADS_BANK0 (1u << 8)
#define RESET_TIMER (1u << 21)
#define RESET_UART0 (1u << 22)

#define XOSC_CTRL 0x40024000u
#define XOSC_ENABLE_1_TO_15_MHZ 0xFABAA0u
#define XOSC_STATUS 0x40024004u
#define XOSC_STABLE 0x80000000u
#define XOSC_STARTUP 0x4002400Cu

#define CLK_REF_CTRL 0x40008030u
#define CLK_REF_FROM_XOSC 2u
#define CLK_REF_SELECTED 0x40008038u
#define CLK_PERI_CTRL 0x40008048u
#define CLK_PERI_ENABLE_FROM_SYS (1u << 11)
#define WATCHDOG_TICK 0x4005802Cu
#define WATCHDOG_TICK_ENABLE (1u << 9)

#define GPIO0_CTRL 0x40014004u
#define GPIO1_CTRL 0x4001400Cu
#define GPIO_FUNCTION_UART 2u
#define PADS_GPIO1 0x4001C008u
#define PADS_PULL_DOWN (1u << 2)
#define PADS_PULL_UP (1u << 3)

/* UART0, a PL011 with FIFOs of 32 */
#define UART_DATA 0x40034000u
#define UART_OVERRUN (1u << 11)
#define UART_FLAGS 0x40034018u
#define UART_RX_EMPTY (1u << 4)
#define UART_TX_FULL (1u << 5)
#define UART_DIVIDER 0x40034024u
#define UART_FRACTION 0x40034028u
#define UART_LINE 0x4003402Cu
#define UART_FIFOS (1u << 4)
#define UART_8_BITS (3u << 5)
#define UART_CONTROL 0x40034030u
#define UART_ENABLE 1u
#define UART_TX_ENABLE (1u << 8)
#define UART_RX_ENABLE (1u << 9)
#define UART_LEVELS 0x40034034u
#define UART_INTERRUPTS 0x40034038u
#define UART_RX (1u << 4)
#define UART_RX_TIMEOUT (1u << 6)

#define TIMER_ALARM 0x40054010u
#define TIMER_RAW_HIGH 0x40054024u
#define TIMER_RAW_LOW 0x40054028u
#define TIMER_INTERRUPT 0x40054034u
#define TIMER_INTERRUPTS 0x40054038u
#define TIMER_ALARM0 1u

enum { IRQ_TIMER0 = 0, IRQ_UART0 = 20 };

#endif
