# A Cortex-M3 on an MPS2 board, as QEMU has it (mps2-an385). The C library gives memset and strcpy; start-up is
# our own, ports/common/cortex_m.c.
CC := arm-none-eabi-gcc
CFLAGS ?= -Os
MACHINE := --specs=picolibc.specs -mcpu=cortex-m3 -mthumb -ffunction-sections -fdata-sections
LINK := -nostartfiles -L ports/common -T $(PORT_DIR)/board.ld -Wl,--gc-sections
SUFFIX := .elf
SIZE := arm-none-eabi-size
PORT_SOURCES := ports/common/board_port.c ports/common/cortex_m.c
PORT_RXBUF := 256
PORT_TXBUF := 0
# The 16 kB of RAM that board.ld gives have no room for 2 MB, but for more than 128 received bytes.
SMALL := 1
RXBUF ?= $(PORT_RXBUF)
