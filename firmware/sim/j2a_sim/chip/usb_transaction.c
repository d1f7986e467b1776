/* See usb_device.h: what the endpoints answer. Section numbers are those of the ATmega16U4/32U4 data sheet,
 * edition J. */
#include <stddef.h>
#include <string.h>

#include "usb_endpoint.h"

static usb_answer_t answer_in(usb_device_t *u, usb_endpoint_t *e)
{
    int control = type(e) == USB_CONTROL;
    if (!control && !is_in(e))
        return USB_NONE;
    if (e->stall && !e->unacknowledged) /* a retry comes before STALL (22.11.2) */
        return USB_STALL;
    if (control ? e->bank != BANK_IN : !e->busy)
        return USB_NAK;
    int bank = control ? 0 : e->bus_bank;
    u->flight.length = e->count[bank];
    u->flight.toggle = e->toggle;
    for (unsigned i = 0; i < u->flight.length; i++)
        u->flight.data[i] = *cell(u, e, bank, i);
    return USB_ACK;
}

static usb_answer_t answer_out(usb_device_t *u, usb_endpoint_t *e)
{
    int control = type(e) == USB_CONTROL;
    if (!control && is_in(e))
        return USB_NONE;
    u->flight.repeated = u->flight.toggle != e->expected;
    if (u->flight.repeated)
        return USB_ACK;
    if (e->stall)
        return USB_STALL;
    if (!control)
        return e->busy < e->banks ? USB_ACK : USB_NAK;
    if (e->read_request && e->bank != BANK_SETUP && !e->status_begun) {
        /* 22.12.2: the first OUT of the status stage gets NAK, and what was not sent is dropped. */
        e->status_begun = 1;
        e->bank = e->bank == BANK_IN ? BANK_FREE : e->bank;
        e->at = e->unacknowledged = 0;
        u->on_change(u->param); /* the next one will get ACK */
        return USB_NAK;
    }
    return e->bank == BANK_FREE ? USB_ACK : USB_NAK;
}

usb_answer_t usb_device_token(usb_device_t *u, usb_token_t token, unsigned address, unsigned endpoint,
                              int toggle, const uint8_t *data, unsigned length)
{
    usb_flight_t *f = &u->flight;
    unsigned own = u->udaddr & 0x80 ? u->udaddr & 0x7f : 0;
    f->endpoint = NULL;
    f->answer = USB_NONE;
    if (!usb_device_pulls_up(u) || !usb_clocked(u) || address != own || (int)endpoint >= usb_endpoint_count(u))
        return USB_NONE;
    usb_endpoint_t *e = &u->endpoints[endpoint];
    if (!works(e) || type(e) == USB_ISOCHRONOUS)
        return USB_NONE;
    f->token = token;
    f->toggle = toggle;
    f->length = length;
    f->repeated = 0;
    if (length)
        memcpy(f->data, data, length);
    if (token == USB_IN)
        f->answer = answer_in(u, e);
    else if (token == USB_OUT)
        f->answer = answer_out(u, e);
    else if (type(e) == USB_CONTROL && length == 8 && !toggle)
        f->answer = USB_ACK;
    if (f->answer != USB_NONE)
        f->endpoint = e;
    return f->answer;
}

static void sent(usb_endpoint_t *e)
{
    e->toggle ^= 1;
    e->unacknowledged = 0;
    if (type(e) == USB_CONTROL) {
        e->bank = BANK_FREE;
        e->flags |= UEINTX_TXINI;
        e->at = 0;
        return;
    }
    e->busy--;
    e->bus_bank = next_bank(e, e->bus_bank);
    if (!(e->flags & UEINTX_FIFOCON))
        bank_to_cpu(e);
}

static void store(usb_device_t *u, usb_endpoint_t *e, int bank)
{
    unsigned length = u->flight.length;
    if (length > e->size) { /* 22.15: the rest is lost, the packet acknowledged all the same */
        length = e->size;
        e->errors |= UESTA0X_OVERFI;
    }
    for (unsigned i = 0; i < length; i++)
        *cell(u, e, bank, i) = u->flight.data[i];
    e->count[bank] = length;
}

static void received(usb_device_t *u, usb_endpoint_t *e)
{
    if (u->flight.repeated) {
        u->repeated++;
        return;
    }
    e->seen_toggle = e->expected;
    e->expected ^= 1;
    if (type(e) == USB_CONTROL) {
        store(u, e, 0);
        e->bank = BANK_OUT;
        e->at = 0;
        e->flags |= UEINTX_RXOUTI;
        e->flags = e->read_request ? e->flags | UEINTX_TXINI : e->flags & ~UEINTX_TXINI;
        return;
    }
    store(u, e, e->bus_bank);
    e->bus_bank = next_bank(e, e->bus_bank);
    e->busy++;
    if (!(e->flags & UEINTX_FIFOCON))
        bank_to_cpu(e);
}

/* A SETUP ends STALL and whatever was going on; RXOUTI of an OUT that nobody took stays set. */
static void set_up(usb_device_t *u, usb_endpoint_t *e)
{
    store(u, e, 0);
    e->bank = BANK_SETUP;
    e->at = 0;
    e->stall = e->status_begun = e->unacknowledged = 0;
    e->toggle = e->expected = 1;
    e->read_request = u->flight.data[0] >> 7;
    e->flags = (e->flags & ~(UEINTX_TXINI | UEINTX_STALLEDI)) | UEINTX_RXSTPI;
}

usb_answer_t usb_device_handshake(usb_device_t *u, int acknowledged)
{
    usb_flight_t *f = &u->flight;
    usb_endpoint_t *e = f->endpoint;
    f->endpoint = NULL;
    if (!e)
        return USB_NONE; /* or the endpoint was reset meanwhile */
    if (f->answer == USB_NAK)
        e->flags |= f->token == USB_IN ? UEINTX_NAKINI : UEINTX_NAKOUTI;
    else if (f->answer == USB_STALL)
        e->flags |= UEINTX_STALLEDI;
    else if (f->token == USB_SETUP)
        set_up(u, e);
    else if (f->token == USB_OUT)
        received(u, e);
    else if (acknowledged)
        sent(e);
    else
        e->unacknowledged = 1;
    usb_levels(u);
    return f->answer;
}
