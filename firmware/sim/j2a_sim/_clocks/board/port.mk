# A shared library instead of a program: the bench loads it once for each board and is its main loop.
CFLAGS ?= -O2
MACHINE := -fPIC
LINK := -shared
SUFFIX := .so
OWN_MAIN := 1
PORT_RXBUF := 4096
