# The drivers use an AVR's hardware, beside timer 1 of this port.
ifneq ($(PORT),avr-serial)
$(error APP=servo is for PORT=avr-serial, because its drivers use the hardware of an AVR)
endif
OWN_MAIN := 1
# A request may come while a sample is sent.
RXBUF ?= 64
DRIVERS := drivers drivers/avr
