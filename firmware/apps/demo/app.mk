# Room for a few requests while a function runs, where RAM is scarce.
ifdef SMALL
RXBUF ?= 128
APP_OPTIONS := -DDEMO_STORE_BYTES=256
else
APP_OPTIONS := -DDEMO_STORE_BYTES=2097152 -DJ2A_DEBUGBUF=1024
endif
