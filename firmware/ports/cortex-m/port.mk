# A Cortex-M3 on an MPS2 board, as QEMU has it (mps2-an385), without any library but the compiler's own.
CC := arm-none-eabi-gcc
CFLAGS ?= -Os
# The loops of freestanding.c must not be turned into calls of the functions that they are.
MACHINE := -mcpu=cortex-m3 -mthumb -ffreestanding -fno-tree-loop-distribute-patterns \
	-ffunction-sections -fdata-sections
LINK := -nostartfiles -nolibc -L ports/common -T $(PORT_DIR)/board.ld -Wl,--gc-sections
SUFFIX := .elf
SIZE := arm-none-eabi-size
PORT_SOURCES := ports/common/board_port.c ports/common/cortex_m.c ports/common/freestanding.c
# QEMU's UART holds the host back, so what is lost is lost in the ring, and this is little enough for that.
PORT_RXBUF := 128
PORT_TXBUF := 0
# The 16 kB of RAM that board.ld gives have no room for a store of 2 MB.
SMALL := 1
