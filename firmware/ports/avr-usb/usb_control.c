/* Control transfers at endpoint 0, see usb.h. In: the interrupt USB_COM. Out: the answers of usb_answer() in
 * packets, the status of a transfer, or a stall.
 * Rule: an interrupt deals with one packet, and waits for none; so it is short, and an aborted transfer is
 * nothing but the next SETUP. */
#include <avr/interrupt.h>
#include <avr/pgmspace.h>

#include "usb.h"

static const uint8_t *source; /* what is being sent, in flash or by usb_descriptor_byte() */
static uint8_t sent, size;    /* bytes of it */
static bool sending;          /* another packet, perhaps an empty one, has to follow */
static bool ends_short;       /* the host asked for more than there is */
uint8_t usb_new_address;

/* Sends the next packet. A short one is the last, and so is a full one after which the host expects no
 * more. One that has to wait is due again when this interrupt has ended. */
static void send_packet(void) {
    uint8_t room = USB_PACKET0;
#if J2A_PORT_FRAMES
    if (usb_in_ram) {
        for (; room != 0 && sent != size; room--, sent++)
            UEDATX = usb_in_ram[sent];
    } else
#endif
    if (!source && usb_descriptor_waits())
        return;
    for (; room != 0 && sent != size; room--, sent++)
        UEDATX = source ? pgm_read_byte(source + sent) : usb_descriptor_byte(sent);
    if (room != 0 || (sent == size && !ends_short))
        sending = false;
    UEINTX = (uint8_t)~_BV(TXINI);
}

/* A SETUP may come while another one is being read, and takes its place then. What is left after 8 bytes is
 * the rest of it: the last 8, around a ring, are the one that counts. The data sheets do not say that UEBCLX
 * counts a SETUP; where it stands still, 8 bytes are all. */
static void take_setup(void) {
    static usb_setup setup;
    static uint8_t ring[sizeof setup];
    uint8_t *to = (uint8_t *)&setup;
    uint8_t limit = 3 * sizeof ring;
    uint8_t next = 1;
    uint8_t i = UEBCLX;

    ring[0] = UEDATX;
    if (UEBCLX == i)
        limit = sizeof ring;
    do
        ring[next++ % sizeof ring] = UEDATX;
    while (next < sizeof ring || (next < limit && UEBCLX != 0));
    UEINTX = (uint8_t)~(_BV(RXSTPI) | _BV(RXOUTI));
    UECONX = _BV(EPEN) | _BV(STALLRQC); /* which may have been meant for the one before */
    for (i = sizeof setup; i != 0; i--)
        *to++ = ring[next++ % sizeof ring];
    usb_new_address = 0;
    sent = 0;
    size = usb_answer(&setup, &source);
    UENUM = 0;
    if (size == USB_STALL) {
        UEIENX = _BV(RXSTPE);
        if (!(UEINTX & _BV(RXSTPI))) /* or it would meet the next one, which is there already */
            UECONX = _BV(EPEN) | _BV(STALLRQ);
        return;
    }
    ends_short = true;
    if (setup.length_high == 0 && setup.length <= size) {
        size = setup.length;
        ends_short = false;
    }
    sending = true; /* without a data stage it is the status that is sent, an empty packet */
    UEIENX = _BV(RXSTPE) | _BV(RXOUTE) | _BV(TXINE);
}

/* There is room for a packet, because the host has taken the last one, or asks for the first. */
static void packet_taken(void) {
    if (sending) {
        send_packet();
        return;
    }
    UEIENX = _BV(RXSTPE) | _BV(RXOUTE);
    if (usb_new_address != 0) { /* the two must not be written at once */
        UDADDR = usb_new_address & (uint8_t)~_BV(ADDEN);
        if (usb_new_address != _BV(ADDEN))
            UDADDR = usb_new_address;
        usb_new_address = 0;
    }
}

ISR(USB_COM_vect) {
    uint8_t flags;
    UENUM = 0;
    flags = UEINTX & UEIENX;
    if (flags & _BV(RXSTPI)) {
        take_setup();
    } else if (flags & _BV(RXOUTI)) { /* the status stage, perhaps before all was taken */
        UEINTX = (uint8_t)~_BV(RXOUTI);
        UEIENX = _BV(RXSTPE);
    } else if (flags & _BV(TXINI)) {
        packet_taken();
    }
}

void usb_control_reset(void) {
    UENUM = 0;
    UECONX = _BV(EPEN);
    UECFG0X = USB_CONTROL;
    UECFG1X = USB_SIZE_16;
    UEIENX = _BV(RXSTPE);
    UDADDR = 0;
    usb_new_address = 0;
}
