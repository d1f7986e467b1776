# A Raspberry Pi Pico without its SDK. Besides the .elf there is a .uf2, to be copied onto a Pico that was
# switched on with BOOTSEL held down. BAUD: 2400 to 750000.
CC := arm-none-eabi-gcc
CFLAGS ?= -Os
MACHINE := -mcpu=cortex-m0plus -mthumb -DBAUD=$(BAUD)u -ffunction-sections -fdata-sections --specs=picolibc.specs
LINK := -nostartfiles -L ports/common -T $(PORT_DIR)/rp2040.ld -Wl,--gc-sections
SUFFIX := .elf
# Runs when the image is linked: writes the checksum that the boot ROM asks for, and the .uf2.
FINISH = $(PYTHON) $(PORT_DIR)/image.py
SIZE := arm-none-eabi-size
PORT_SOURCES := ports/common/board_port.c ports/common/cortex_m.c
PORT_RXBUF := 128
SMALL := 1
