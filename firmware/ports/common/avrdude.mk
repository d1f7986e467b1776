# How `make flash` writes an AVR, for ports with FLASHER := avrdude. DEVICE is the serial port of the board, or usb
# for a programmer on the USB. PROGRAMMER is one that `avrdude -c ?` lists; the default is the boot loader of the
# Arduino board with this chip.
BOOTLOADER_atmega328p := arduino -b 115200 -D
BOOTLOADER_atmega2560 := wiring -b 115200 -D
BOOTLOADER_atmega32u4 := avr109 -b 57600 -D
PROGRAMMER ?= $(BOOTLOADER_$(MCU))
$(if $(PROGRAMMER),,$(error MCU=$(MCU): no Arduino board with this chip is known here; give a programmer, such as \
	PROGRAMMER=usbasp DEVICE=usb))

$(foreach program,avr-gcc avr-objcopy avrdude,$(if $(shell command -v $(program)),,\
	$(error $(program) is missing: install the package $(patsubst avr-gcc,gcc-avr,$(program:avr-objcopy=binutils-avr)))))

FLASH = avr-objcopy -O ihex -R .eeprom $(IMAGE) $(IMAGE:.elf=.hex) && \
	avrdude -p $(MCU) -c $(PROGRAMMER) -P '$(DEVICE)' -U 'flash:w:$(IMAGE:.elf=.hex):i'
