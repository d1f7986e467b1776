CC := avr-gcc
CFLAGS ?= -Os -flto
MACHINE := -mmcu=atmega328p -DF_CPU=16000000UL -DBAUD=$(BAUD)UL \
	-ffunction-sections -fdata-sections -fshort-enums -mcall-prologues
LINK := -Wl,--gc-sections -mrelax
SUFFIX := .elf
SIZE := avr-size
PORT_RXBUF := 32
PORT_TXBUF := 8
SMALL := 1
