# A Cortex-M3 on an MPS2 board, as QEMU has it (mps2-an385), without any library but the compiler's own.
CC := arm-none-eabi-gcc
CFLAGS ?= -Os
MACHINE := -mcpu=cortex-m3 -mthumb -ffreestanding -DBAUD=$(BAUD)u \
	-ffunction-sections -fdata-sections
LINK := -nostartfiles -nolibc -L ports/common -T $(PORT_DIR)/board.ld -Wl,--gc-sections
SUFFIX := .elf
SIZE := arm-none-eabi-size
PORT_SOURCES := ports/common/board_port.c ports/common/cortex_m.c ports/common/freestanding.c
# QEMU's UART has no baud rate: it gives the next byte as soon as one is read, which may be before the main
# loop has gone on. So a largest frame (518 bytes) must fit; and as it holds the host back while a byte is
# there, what is lost is lost in this ring, which is little enough for that.
PORT_RXBUF := 520
# The 16 kB of RAM that board.ld gives have no room for a store of 2 MB, but for the ring.
SMALL := 1
RXBUF ?= $(PORT_RXBUF)
