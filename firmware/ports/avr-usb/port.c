/* AVR with a USB device controller (ATmega16U4, 32U4, 8U2, 16U2, 32U2, AT90USB162): the link are two bulk
 * endpoints. Bytes flow straight out of the controller's memory and straight into it, there is no ring: while
 * it is full the controller refuses packets, so none is lost. Timer 1 runs freely and is both clocks.
 * Rules: an endpoint is chosen and used with interrupts off, because an interrupt may set all of them up
 * anew. A suspend drops nothing. What is dropped is dropped up to the end of the frame, and that is where the
 * main loop asks for a byte again. */
#include <avr/interrupt.h>
#include <util/atomic.h>

#include "usb.h"
#include "j2a_port.h"

#if J2A_WITH_SYNCUSB
#include "sync_usb.h"
#endif

#if J2A_TXBUF > 0
#error "this port has no transmit buffer, so J2A_TXBUF must be 0"
#endif

enum { DROPPING = USB_PORT }; /* what is sent, until the frame is over */

/* A packet has been begun, or the last one was full and an empty one may have to follow. */
static bool packet_due;

void j2a_port_init(int argc, char **argv) {
    (void)argc;
    (void)argv;
    avr_clock_start();
    usb_start();
    sei();
}

/* Called between frames. After a restart what had been received is given up first, and the error that the
 * parser makes of it is dropped. */
static void find_out(void) {
    bool lost = false;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        if (usb_trouble & USB_RESTARTED) {
            usb_trouble = (usb_trouble & (uint8_t)~USB_RESTARTED) | DROPPING;
            packet_due = false;
            lost = true;
        } else {
            usb_trouble &= (uint8_t)~DROPPING;
        }
    }
    if (lost)
        j2a_rx_lost();
}

int16_t j2a_port_rx(void) {
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        if (usb_trouble == 0) {
            const uint8_t flags = usb_flags_of(USB_RX);
            int16_t byte = -1;
            if (flags & _BV(RWAL))
                byte = UEDATX;
            if ((flags & _BV(RXOUTI)) && UEBCLX == 0) /* not before: a halted endpoint keeps what it has */
                UEINTX = USB_RELEASE;
            return byte;
        }
    }
    find_out();
    return -1;
}

/* Returns whether there was room. */
static inline __attribute__((always_inline)) bool put(uint8_t byte) {
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        if (usb_trouble == 0 && (usb_flags_of(USB_TX) & _BV(RWAL))) {
            UEDATX = byte;
            packet_due = true;
            if (!(UEINTX & _BV(RWAL)))
                UEINTX = USB_SEND;
            return true;
        }
    }
    return false;
}

/* Waits for the host as long as it likes, also in a suspend; what nobody is there to take is dropped. Apart
 * from j2a_port_tx(), where its registers would cost each byte. */
static __attribute__((noinline)) void wait_and_put(uint8_t byte) {
    do {
        ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
            usb_events();
            if (usb_trouble & (uint8_t)~USB_SUSPENDED) {
                usb_trouble |= DROPPING;
                return;
            }
        }
#if J2A_USB_SLEEP
        usb_sleep();
#endif
    } while (!put(byte));
}

void j2a_port_tx(uint8_t byte) {
    if (!put(byte))
        wait_and_put(byte);
}

uint16_t j2a_port_overruns(void) {
    return 0; /* the host waits instead */
}

/* The end of a burst: what has been collected is sent, and after a full packet an empty one, so that the host
 * knows that nothing follows. */
void j2a_port_idle(void) {
#if J2A_WITH_SYNCUSB
    receive_sync(); /* first, because it may send */
#endif
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        if (usb_trouble == 0 && packet_due && (usb_flags_of(USB_TX) & _BV(RWAL))) {
            UEINTX = USB_SEND;
            packet_due = false;
        }
    }
#if J2A_USB_SLEEP
    usb_sleep();
#endif
}
