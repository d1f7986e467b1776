# The functions of the demo, too: the conformance suite judges a device by them.
include apps/demo/app.mk
OWN_MAIN := 1
APP_OPTIONS += -DJ2A_WITH_INTERFACE=1
PORT_SOURCES += apps/demo/app.c
APP_OPTIONS += -DTRANSDUCERS_NUMBERS=$(if $(filter posix,$(PORT)),1,0)
