# How this port is compiled. FILL IN what your chip needs; as it stands here it is this machine.
# Paths are seen from firmware/, those of this folder begin with $(PORT_DIR)/.
# $(BAUD), should your board.c use it, is 115200, or what a line BAUD := ... here or the command says.
# CC := arm-none-eabi-gcc
# MACHINE := -mcpu=cortex-m0 -mthumb -DBAUD=$(BAUD) -ffunction-sections -fdata-sections
# LINK := -T $(PORT_DIR)/board.ld -Wl,--gc-sections
# SUFFIX := .elf
# SIZE := arm-none-eabi-size
CFLAGS ?= -Os

# Ring, clocks and all that boards have in common; in your own folder are only the functions of board.h.
PORT_SOURCES := ports/common/board_port.c

# Received bytes that are held while a function runs; 32 and more. Costs so much RAM and one byte.
PORT_RXBUF := 64
# Apps that can do with less RAM then do (the demo also holds 128 received bytes, whatever stands
# above); leave it out with 16 kB and more.
SMALL := 1
