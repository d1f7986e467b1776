# A 32-bit RISC-V as QEMU's machine `virt` has it, without any library but the compiler's own.
CC := riscv64-unknown-elf-gcc
CFLAGS ?= -Os
MACHINE := -march=rv32imac_zicsr -mabi=ilp32 -ffreestanding \
	-DBAUD=$(BAUD)u -ffunction-sections -fdata-sections
# For the linker zicsr is left out: by that name it finds no library of the compiler.
LINK := -march=rv32imac -nostartfiles -nolibc -static -T $(PORT_DIR)/virt.ld -Wl,--gc-sections
SUFFIX := .elf
SIZE := riscv64-unknown-elf-size
PORT_SOURCES := ports/common/board_port.c ports/common/freestanding.c
PORT_RXBUF := 255
