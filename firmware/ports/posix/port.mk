CFLAGS ?= -O2
PORT_RXBUF := 4096
PORT_TXBUF := 4096
PORT_SOURCES := ports/common/crystal.c ports/common/kept_file.c
