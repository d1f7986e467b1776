/* Start-up in machine mode: the processor flows in as a reset leaves it, out it goes into main() with a
 * stack and zeroed variables. Those with other values need no copy: the loader puts the image into RAM. */
    .section .start, "ax"
    .globl _start
_start:
    csrr t0, mhartid
    bnez t0, sleep              /* only the first hart runs */
    .option push
    .option norelax             /* gp cannot be loaded by means of itself */
    la gp, __global_pointer$
    .option pop
    la sp, stack_top
    la t0, bss_start
    la t1, bss_end
clear:
    sw zero, 0(t0)
    addi t0, t0, 4
    bltu t0, t1, clear
    la t0, trap
    csrw mtvec, t0
    call main
sleep:
    wfi
    j sleep
