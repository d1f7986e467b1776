/* Registers and interrupts of QEMU's RISC-V machine `virt`, as far as the port needs them. */
#ifndef VIRT_H
#define VIRT_H

#define REGISTER_8(address) (*(volatile uint8_t *)(address))
#define REGISTER_32(address) (*(volatile uint32_t *)(address))

/* UART: NS16550 */
#define UART_CLOCK_HZ 3686400u
#define UART_DATA REGISTER_8(0x10000000u)
#define UART_INTERRUPTS REGISTER_8(0x10000001u)
#define UART_DIVIDER_LOW UART_DATA        /* with LINE_DIVIDER */
#define UART_DIVIDER_HIGH UART_INTERRUPTS /* the same */
#define UART_FIFO REGISTER_8(0x10000002u)
#define UART_LINE REGISTER_8(0x10000003u)
#define UART_STATUS REGISTER_8(0x10000005u)
enum {
    INTERRUPT_RECEIVED = 0x01,
    FIFO_CLEARED_1 = 0x07, /* on; interrupt at the first byte */
    FIFO_CLEARED_8 = 0x87, /* on; interrupt at 8 of 16 bytes, or when none has come for 4 characters */
    LINE_8N1 = 0x03,
    LINE_DIVIDER = 0x80,
    STATUS_RECEIVED = 0x01,
    STATUS_OVERRUN = 0x02, /* cleared by reading the status */
    STATUS_CAN_WRITE = 0x20
};

/* Interrupt controller: PLIC, for the first hart in machine mode */
#define UART_IRQ 10u
#define PLIC_PRIORITY_UART REGISTER_32(0x0C000000u + 4 * UART_IRQ)
#define PLIC_ENABLE REGISTER_32(0x0C002000u)
#define PLIC_CLAIM REGISTER_32(0x0C200004u)
#define CAUSE_EXTERNAL 0x8000000Bu
#define MSTATUS_MIE 0x008u
#define MIE_TIMER 0x080u
#define MIE_EXTERNAL 0x800u

/* Clock */
#define MTIME_PER_US 10u
#define MTIME REGISTER_32(0x0200BFF8u)
#define MTIME_HIGH REGISTER_32(0x0200BFFCu)
#define MTIMECMP REGISTER_32(0x02004000u)
#define MTIMECMP_HIGH REGISTER_32(0x02004004u)

#endif
