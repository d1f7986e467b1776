# Measures itself (see app.c), with the size budget's options.
OWN_MAIN := 1
# What mark 3 lets come in must fit; there is no ring for transmitting, so that marks 5 to 7 wait for nothing.
RXBUF ?= 32
TXBUF ?= 0
APP_OPTIONS := -DJ2A_WITH_DEBUG=0
