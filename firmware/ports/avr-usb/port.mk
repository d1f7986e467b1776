# MCU and FREQ say which chip it is, and its crystal in Hz: 16000000 or 8000000.
MCU ?= atmega32u4
FREQ ?= 16000000
# What the board says of itself: ids as 0x and four digits, its name, and its serial number; without SERIAL
# that is the number that the chip was made with.
USB_VENDOR ?= J2A_USB_VENDOR
USB_PRODUCT ?= J2A_USB_PRODUCT
USB_NAME ?= $(MCU)
SERIAL ?=
CHIPS := atmega8u2 atmega16u2 atmega32u2 atmega16u4 atmega32u4 at90usb82 at90usb162
MCU_CHECK := $(if $(filter $(MCU),$(CHIPS)),,$(error MCU=$(MCU): this port is for $(CHIPS)))
ID_CHECK := $(if $(shell echo '$(USB_VENDOR) $(USB_PRODUCT)' | \
	grep -xE '(0x[0-9A-Fa-f]{4}|J2A_USB_VENDOR) (0x[0-9A-Fa-f]{4}|J2A_USB_PRODUCT)'),,\
	$(error USB_VENDOR=$(USB_VENDOR) USB_PRODUCT=$(USB_PRODUCT): give ids as 0x and four hexadecimal digits))
NAME_CHECK := $(if $(shell echo '$(USB_NAME)' | grep -xE '[A-Za-z0-9._ -]{1,126}'),,\
	$(error USB_NAME=$(USB_NAME): give 1 to 126 letters, digits, blanks, dots, minuses and underscores))
SERIAL_CHECK := $(if $(shell echo 'x$(SERIAL)' | grep -xE 'x[A-Za-z0-9._-]{0,126}'),,\
	$(error SERIAL=$(SERIAL): give up to 126 letters, digits, dots, minuses and underscores))
CC := avr-gcc
# As for avr-serial.
CFLAGS ?= -Os -flto -fno-move-loop-invariants -fno-tree-pre -fno-split-wide-types -fno-gcse
MACHINE := -mmcu=$(MCU) -DF_CPU=$(FREQ)UL -DUSB_VENDOR=$(USB_VENDOR) -DUSB_PRODUCT=$(USB_PRODUCT) \
	"-DUSB_NAME=\"$(USB_NAME)\"" "-DUSB_SERIAL=\"$(SERIAL)\"" -ffunction-sections -fdata-sections -fshort-enums
LINK := -Wl,--gc-sections -mrelax
# What refuses a program that leaves the stack too little; see STACK in ../../Makefile.
RAM_CHECK := ports/common/avr_ram.ld
SUFFIX := .elf
SIZE := avr-size
PORT_SOURCES := ports/common/avr_clock.c ports/common/avr_eeprom.c ports/common/avr_reset.c
# Only a promise, which costs no memory: the host keeps what the chip has no room for.
PORT_RXBUF := 1024
RXBUF ?= $(PORT_RXBUF)
SMALL := 1
FLASHER := avrdude
