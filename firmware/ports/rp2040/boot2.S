/* The second stage of the start-up. In: the boot ROM reads the first 256 bytes of the flash, compares their
 * checksum, copies them to the end of the RAM and jumps there, at about 6 MHz of its ring oscillator. Out: the
 * program starts by its vector table, and all of the flash can be read where it is mapped.
 * Rules: runs wherever it was copied to; the flash cannot be read meanwhile. The checksum at the end is image.py's to fill in.
 * Each read becomes the command 03h with an address of 24 bits, on one data line: all flash chips know it.
 * The price is speed, 64 clocks of the flash for 4 bytes; the cache of 16 kB makes up for it. */
    .syntax unified
    .cpu cortex-m0plus
    .thumb

    .equ SSI, 0x18000000
    .equ CTRLR0, 0x00
    .equ CTRLR1, 0x04
    .equ SSIENR, 0x08
    .equ BAUDR, 0x14
    .equ SPI_CTRLR0, 0xF4
    .equ READ_FRAMES_OF_32_BITS, (31 << 16) | (3 << 8)      /* send command and address, then receive */
    .equ COMMAND_03_ADDRESS_24, (0x03 << 24) | (2 << 8) | (6 << 2)
    .equ VTOR, 0xE000ED08
    .equ VECTORS, 0x10000100

    .section .boot2, "ax"
    .globl boot2
    .thumb_func
boot2:
    ldr r3, =SSI
    movs r0, #0
    str r0, [r3, #SSIENR]       /* it can only be changed while it is off */
    movs r1, #2                 /* clk_sys / 2: 6 MHz with the crystal */
    str r1, [r3, #BAUDR]
    ldr r1, =READ_FRAMES_OF_32_BITS
    str r1, [r3, #CTRLR0]
    str r0, [r3, #CTRLR1]       /* one of them for each read */
    ldr r1, =COMMAND_03_ADDRESS_24
    ldr r2, =SSI + SPI_CTRLR0
    str r1, [r2]
    movs r0, #1
    str r0, [r3, #SSIENR]
    ldr r0, =VECTORS
    ldr r1, =VTOR
    str r0, [r1]
    ldmia r0!, {r1, r2}         /* stack pointer, reset handler */
    msr msp, r1
    bx r2
    .ltorg
    .space 252 - (. - boot2)
    .word 0                     /* checksum */
