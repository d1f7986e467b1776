/* The endpoint of the interface SyncUSB, see usb.h. In: its packets. Out: those of the right size. */
#include <util/atomic.h>

#include "usb.h"
#include "j2a_const.h"

#if J2A_WITH_SYNCUSB
bool usb_sync_received(uint8_t *packet) {
    bool complete = false;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        if (usb_trouble == 0 && (usb_flags_of(USB_SYNC) & _BV(RXOUTI)) && !(UECONX & _BV(STALLRQ))) {
            if (UEBCLX == J2A_SYNCUSB_SIZE) {
                uint8_t i;
                for (i = 0; i < J2A_SYNCUSB_SIZE; i++)
                    packet[i] = UEDATX;
                complete = true;
            }
            UEINTX = USB_RELEASE;
        }
    }
    return complete;
}
#endif
