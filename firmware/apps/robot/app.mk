OWN_MAIN := 1
# A request may come while a sample is sent.
RXBUF ?= 64
APP_OPTIONS := -DJ2A_WITH_DEBUG=0
