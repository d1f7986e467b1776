/* The interface SyncUSB of this port, for port.c alone. In: packets at its endpoint. Out: those of the right size, to the
 * clock and to the application. */
#ifndef SYNC_USB_H
#define SYNC_USB_H

#include <util/atomic.h>

#include "usb.h"
#include "j2a_clock.h"
#include "j2a_port.h"

/* For applications that have none. */
__attribute__((weak)) void j2a_app_sync_usb(const uint8_t *packet) {
    (void)packet;
}

static void receive_sync(void) {
    uint8_t packet[J2A_SYNCUSB_SIZE];
    bool complete = false;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        if (usb_trouble == 0 && (usb_flags_of(USB_SYNC) & _BV(RXOUTI)) && !(UECONX & _BV(STALLRQ))) {
            if (UEBCLX == sizeof packet) {
                uint8_t i;
                for (i = 0; i < sizeof packet; i++)
                    packet[i] = UEDATX;
                complete = true;
            }
            UEINTX = USB_RELEASE;
        }
    }
    if (!complete)
        return;
#if J2A_PORT_FRAMES
    j2a_clock_packet(packet);
#endif
    j2a_app_sync_usb(packet);
}

#endif
