CC := avr-gcc
CFLAGS ?= -Os -flto
MACHINE := -mmcu=atmega328p -ffunction-sections -fdata-sections -fshort-enums -mcall-prologues
LINK := -Wl,--gc-sections -mrelax
SUFFIX := .elf
SIZE := avr-size
PORT_SOURCES := ports/common/board_port.c
PORT_RXBUF := 64
SMALL := 1
