/* What every Cortex-M has: start-up, the interrupt controller, and SysTick as the clock. In: the symbols of
 * cortex_m.ld, the board's interrupts, and the frequency of the processor. Out: main() is called with
 * .data and .bss in order, and the time since cortex_m_start_clock().
 * Rules: written for ARMv6-M and up, in C only; SysTick belongs to this file. To take it, a port names
 * ports/common/cortex_m.c in PORT_SOURCES, links with -nostartfiles, and has a linker script that sets
 * MEMORY (FLASH, RAM) and then says INCLUDE cortex_m.ld (with -L ports/common). */
#ifndef CORTEX_M_H
#define CORTEX_M_H

#include <stdint.h>

/* A register. */
#define CORTEX_M_REG(address) (*(volatile uint32_t *)(uintptr_t)(address))

/* The board's interrupts, which follow the processor's own 16 in the vector table: a board.c has
 *   CORTEX_M_INTERRUPTS = {[0] = uart_received, [8] = timer};
 * One that is left out must not be switched on. */
typedef void (*cortex_m_handler)(void);
#define CORTEX_M_INTERRUPTS \
    __attribute__((section(".vectors.board"), used)) static const cortex_m_handler cortex_m_interrupts[]

/* Where execution begins; the vector table names it. A chip whose boot code wants to be told where to go
 * is told this. */
void cortex_m_reset(void);

/* Switches one of the board's interrupts on, 0..239. */
static inline void cortex_m_enable(uint32_t interrupt) {
    /* NVIC_ISER0 to ISER7: zeros change nothing. */
    CORTEX_M_REG(0xE000E100 + interrupt / 32 * 4) = UINT32_C(1) << interrupt % 32;
}

/* Starts the clock. clock_hz: the frequency of the processor, a whole number of MHz. Called once. */
void cortex_m_start_clock(uint32_t clock_hz);

/* Microseconds since then; from the main context and from interrupts, and with interrupts off for up to the
 * period of SysTick (134 ms at 125 MHz). */
uint64_t cortex_m_us(void);

/* Sleeps until the next interrupt. */
static inline void cortex_m_wait(void) {
    __asm__ volatile("wfi" ::: "memory");
}

#endif
