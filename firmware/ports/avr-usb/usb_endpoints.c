/* The endpoints but 0, see usb.h: which there are, and how they are set up. In: the numbers of spec/LINKS.md.
 * Out: the controller's registers, and a link that begins anew. */
#include <avr/pgmspace.h>

#include "usb.h"
#include "j2a_port.h"

/* An ATmega32U4 has 832 bytes of memory for endpoints, so one packet of each bulk endpoint waits while the
 * other is worked on. An ATmega32U2 has 176, just enough for one packet of 64 each; two of 32 would carry
 * less, because a packet costs the bus as much as 13 bytes. */
#ifdef PINDIV
#define BULK_BANKS (USB_SIZE_64 | USB_TWO_BANKS)
#else
#define BULK_BANKS USB_SIZE_64
#endif
const usb_endpoint usb_endpoints[USB_ENDPOINTS] PROGMEM = {
    {J2A_USB_IN, USB_BULK_IN, BULK_BANKS, 0},
    {J2A_USB_OUT, USB_BULK_OUT, BULK_BANKS, 0},
#if J2A_WITH_SYNCUSB
    {J2A_SYNCUSB_OUT, USB_INTERRUPT_OUT, USB_SIZE_16, 1},
#endif
};

void usb_configure(bool on) {
    uint8_t endpoint;
    usb_trouble = USB_RESTARTED | USB_UNCONFIGURED;
    /* All memory is given back before any is taken: the controller hands it out in the order of the
     * endpoints. */
    for (endpoint = USB_ENDPOINTS; endpoint != 0; endpoint--) {
        UENUM = endpoint;
        UECONX = 0;
        UECFG1X = 0;
    }
    if (!on)
        return;
    for (; endpoint < USB_ENDPOINTS; endpoint++) {
        UENUM = (uint8_t)(endpoint + 1);
        UECONX = _BV(EPEN);
        UECFG0X = pgm_read_byte(&usb_endpoints[endpoint].uecfg0x);
        UECFG1X = pgm_read_byte(&usb_endpoints[endpoint].uecfg1x);
        UECONX = _BV(EPEN) | _BV(STALLRQC) | _BV(RSTDT);
    }
    UERST = (1 << (USB_ENDPOINTS + 1)) - 2;
    UERST = 0;
    usb_trouble = USB_RESTARTED;
}
