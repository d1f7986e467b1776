# The drivers use an AVR's hardware, beside timer 1 of its ports.
ifeq ($(filter avr-%,$(PORT)),)
$(error APP=listing is for PORT=avr-serial and avr-usb, because its drivers use the hardware of an AVR)
endif
OWN_MAIN := 1
# A request may come while a sample is sent.
RXBUF ?= 64
# An ATmega32U2 has 1 KB of RAM. The longest payload is a sample of dist_us, 144 bytes.
ROOM ?= $(if $(filter %u2,$(MCU)),144,255)
APP_OPTIONS := -DJ2A_WITH_DEBUG=0
DRIVERS := drivers drivers/avr
