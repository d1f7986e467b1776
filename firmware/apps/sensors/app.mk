# The drivers use an AVR's hardware, beside timer 1 of this port.
ifneq ($(PORT),avr-serial)
$(error APP=sensors is for PORT=avr-serial, because its drivers use the hardware of an AVR)
endif
OWN_MAIN := 1
# ATmega16U2 and 32U2 have no ADC, and little RAM.
SENSORS_ADC := $(if $(filter %u2,$(MCU)),0,1)
RXBUF ?= $(if $(filter %u2,$(MCU)),64,128)
APP_OPTIONS := -DSENSORS_ADC=$(SENSORS_ADC)
DRIVERS := drivers drivers/avr
