# MCU and FREQ say which chip it is, and its crystal in Hz: 16000000 or 8000000.
MCU ?= atmega32u4
FREQ ?= 16000000
# What the board says of itself: the ids as 0x and four digits, its name, and a serial number of letters and digits;
# without SERIAL it is the number that the chip was made with.
USB_VENDOR ?= J2A_USB_VENDOR
USB_PRODUCT ?= J2A_USB_PRODUCT
USB_NAME ?= $(MCU)
SERIAL ?=
CC := avr-gcc
# As for avr-serial.
CFLAGS ?= -Os -flto -fno-move-loop-invariants -fno-tree-pre -fno-split-wide-types -fno-gcse
MACHINE := -mmcu=$(MCU) -DF_CPU=$(FREQ)UL -DUSB_VENDOR=$(USB_VENDOR) -DUSB_PRODUCT=$(USB_PRODUCT) \
	"-DUSB_NAME=$(USB_NAME)" "-DUSB_SERIAL=$(SERIAL)" -ffunction-sections -fdata-sections -fshort-enums
LINK := -Wl,--gc-sections -mrelax
SUFFIX := .elf
SIZE := avr-size
PORT_SOURCES := ports/common/avr_clock.c
# Only a promise, which costs no memory: the host keeps what the chip has no room for.
PORT_RXBUF := 1024
RXBUF ?= $(PORT_RXBUF)
SMALL := 1
