# An ATmega2560, as docs/porting.md and the template ask for it.
CC := avr-gcc
MACHINE := -mmcu=atmega2560 -ffunction-sections -fdata-sections
LINK := -Wl,--gc-sections
SUFFIX := .elf
SIZE := avr-size
CFLAGS ?= -Os

PORT_SOURCES := ports/common/board_port.c
PORT_RXBUF := 64
SMALL := 1
