# All built-ins but debug: the firmware whose size has a budget.
APP_OPTIONS := -DJ2A_WITH_DEBUG=0
ifneq ($(filter avr-serial avr-usb,$(PORT)),)
# Nobody sends a SIF here, and yet what it takes to send one is counted.
APP_LINK := $(if $(findstring J2A_WITH_SIF=0,$(OPTIONS)),,-Wl,-u,j2a_send_sif)
endif
