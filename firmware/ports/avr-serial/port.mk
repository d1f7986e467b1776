# MCU and FREQ say which chip it is, and its clock in Hz.
MCU ?= atmega328p
FREQ ?= 16000000
CC := avr-gcc
# The last four save 40 to 120 bytes of flash, measured with avr-gcc 5.4.
CFLAGS ?= -Os -flto -fno-move-loop-invariants -fno-tree-pre -fno-split-wide-types -fno-gcse
MACHINE := -mmcu=$(MCU) -DF_CPU=$(FREQ)UL -DBAUD=$(BAUD)UL \
	-ffunction-sections -fdata-sections -fshort-enums
LINK := -Wl,--gc-sections -mrelax
# What refuses a program that leaves the stack too little; see STACK in ../../Makefile.
RAM_CHECK := ports/common/avr_ram.ld
SUFFIX := .elf
SIZE := avr-size
PORT_SOURCES := ports/common/avr_clock.c ports/common/avr_eeprom.c ports/common/avr_reset.c
PORT_RXBUF := 16
SMALL := 1
FLASHER := avrdude
