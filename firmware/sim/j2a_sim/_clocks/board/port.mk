# A shared library instead of a program: the bench loads it once for each board and is its main loop.
CFLAGS ?= -O2
# FRAMES=1: a board with USB.
FRAMES ?= 0
MACHINE := -fPIC -DJ2A_PORT_FRAMES=$(FRAMES)
LINK := -shared
SUFFIX := .so
OWN_MAIN := 1
PORT_RXBUF := 4096
