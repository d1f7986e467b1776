/* See usb_device.h: the endpoints of the controller, their memory, and what they answer. Section numbers are
 * those of the ATmega16U4/32U4 data sheet, edition J. */
#include <string.h>

#include "usb_device.h"

enum { UEINTX = 0xe8, UECONX = 0xeb, UECFG0X, UECFG1X, UESTA0X, UESTA1X, UEIENX, UEDATX, UEBCLX, UEBCHX };
enum { CLEARABLE = UEINTX_NAKINI | UEINTX_NAKOUTI | UEINTX_STALLEDI };

int usb_endpoint_count(const usb_device_t *u) { return u->is_u2 ? 5 : USB_ENDPOINTS; }

usb_endpoint_t *usb_selected(usb_device_t *u)
{
    return u->uenum < usb_endpoint_count(u) ? &u->endpoints[u->uenum] : NULL;
}

static int type(const usb_endpoint_t *e) { return e->cfg0 >> 6; }
static int is_in(const usb_endpoint_t *e) { return e->cfg0 & UECFG0X_IN; }
static int works(const usb_endpoint_t *e)
{
    return e->enabled && !e->held && e->cfg_ok && (e->cfg1 & UECFG1X_ALLOC);
}

int usb_endpoint_interrupt(const usb_endpoint_t *e)
{
    const uint8_t events = CLEARABLE | UEINTX_RXSTPI | UEINTX_RXOUTI | UEINTX_TXINI;
    return (e->flags & e->ien & events) || (e->errors && (e->ien & 0x80));
}

/* ---- memory: each endpoint lies after the one below; of those above only the next one moves ---- */

static void place(usb_device_t *u, usb_endpoint_t *e)
{
    unsigned start = 0;
    for (usb_endpoint_t *below = u->endpoints; below < e; below++)
        if (below->reserved)
            start = below->start + below->reserved;
    e->start = start;
}

static void slide(usb_device_t *u, usb_endpoint_t *e)
{
    usb_endpoint_t *above = e + 1;
    if (above < u->endpoints + usb_endpoint_count(u) && above->reserved)
        place(u, above); /* its data stay behind; one that no longer fits loses what lies outside */
}

static void allocate(usb_device_t *u, usb_endpoint_t *e)
{
    int number = e - u->endpoints;
    unsigned size = 8u << ((e->cfg1 >> 4) & 7), banks = 1 + ((e->cfg1 >> 2) & 3);
    unsigned size_max = !u->is_u2 && number == 1 ? 256 : 64;
    unsigned banks_max = number >= (u->is_u2 ? 3 : 1) ? 2 : 1;
    unsigned dpram = u->is_u2 ? 176 : USB_DPRAM;
    place(u, e);
    e->cfg_ok = size <= size_max && banks <= banks_max && e->start + size * banks <= dpram;
    e->size = e->cfg_ok ? size : 0;
    e->banks = e->cfg_ok ? banks : 0;
    e->reserved = e->size * e->banks;
    slide(u, e);
}

static uint8_t *cell(usb_device_t *u, const usb_endpoint_t *e, int bank, unsigned at)
{
    static uint8_t nowhere;
    unsigned where = e->start + bank * e->size + at;
    return where < USB_DPRAM ? &u->dpram[where] : &nowhere;
}

/* ---- states ---- */

/* What a reset of the endpoint does; its data toggle stays. */
static void restart(usb_device_t *u, usb_endpoint_t *e)
{
    e->flags = e->errors = 0;
    e->busy = e->cpu_bank = e->bus_bank = e->unacknowledged = 0;
    e->at = e->count[0] = e->count[1] = 0;
    e->bank = BANK_FREE;
    e->read_request = e->status_begun = 0;
    if (u->flight.endpoint == e)
        u->flight.endpoint = NULL;
    if (works(e) && type(e) == USB_CONTROL)
        e->flags = UEINTX_TXINI;
    else if (works(e) && is_in(e))
        e->flags = UEINTX_TXINI | UEINTX_FIFOCON;
}

static void disable(usb_device_t *u, usb_endpoint_t *e)
{
    e->enabled = 0; /* configuration and memory stay */
    e->toggle = e->expected = e->seen_toggle = 0;
    e->stall = 0;
    restart(u, e);
}

void usb_endpoints_bus_reset(usb_device_t *u)
{
    for (int i = 1; i < usb_endpoint_count(u); i++)
        disable(u, &u->endpoints[i]);
    u->flight.endpoint = NULL; /* endpoint 0 stays as it is */
}

void usb_endpoint_hold(usb_device_t *u, uint8_t uerst)
{
    for (int i = 0; i < usb_endpoint_count(u); i++) {
        usb_endpoint_t *e = &u->endpoints[i];
        if (e->held != ((uerst >> i) & 1)) {
            e->held = (uerst >> i) & 1;
            restart(u, e);
        }
    }
}

static void bank_to_cpu(usb_endpoint_t *e)
{
    e->flags |= UEINTX_FIFOCON | (is_in(e) ? UEINTX_TXINI : UEINTX_RXOUTI);
    e->at = 0;
}

static int next_bank(const usb_endpoint_t *e, int bank) { return e->banks == 2 ? !bank : bank; }

/* The CPU has done with its bank. */
static void release(usb_endpoint_t *e)
{
    e->flags &= ~UEINTX_FIFOCON;
    if (is_in(e)) {
        e->count[e->cpu_bank] = e->at;
        e->busy++;
    } else {
        e->busy--;
    }
    e->cpu_bank = next_bank(e, e->cpu_bank);
    e->at = 0;
    if (is_in(e) ? e->busy < e->banks : e->busy > 0)
        bank_to_cpu(e);
}

static void kill(usb_device_t *u, usb_endpoint_t *e)
{
    int is_on_wire = u->flight.endpoint == e && u->flight.answer == USB_ACK;
    if (e->busy <= is_on_wire)
        return; /* nothing to kill, or it is being sent */
    e->busy--;
    if (!(e->flags & UEINTX_FIFOCON)) {
        e->cpu_bank = next_bank(e, e->cpu_bank);
        bank_to_cpu(e);
    } else {
        e->bus_bank = e->cpu_bank;
    }
}

static void write_flags(usb_device_t *u, usb_endpoint_t *e, uint8_t value)
{
    uint8_t cleared = e->flags & ~value;
    e->flags &= ~(cleared & CLEARABLE);
    if (type(e) == USB_CONTROL) {
        e->flags &= ~(cleared & (UEINTX_RXSTPI | UEINTX_RXOUTI | UEINTX_TXINI));
        int emptied = (e->bank == BANK_SETUP && (cleared & UEINTX_RXSTPI))
            || (e->bank == BANK_OUT && (cleared & UEINTX_RXOUTI));
        if (emptied) {
            e->bank = BANK_FREE;
            e->flags |= UEINTX_TXINI;
            e->at = 0;
        } else if (e->bank == BANK_FREE && (cleared & UEINTX_TXINI) && !e->status_begun) {
            e->bank = BANK_IN;
            e->count[0] = e->at;
            e->at = 0;
        }
    } else {
        e->flags &= ~(cleared & (is_in(e) ? UEINTX_TXINI : UEINTX_RXOUTI));
        if (cleared & UEINTX_FIFOCON)
            release(e);
        /* Released and killed by one write: the data sheet does not say which comes first. */
        if (is_in(e) && (value & UEINTX_KILLBK))
            kill(u, e);
    }
    if (cleared || (value & UEINTX_KILLBK))
        usb_changed(u);
}

static int may_read(const usb_endpoint_t *e)
{
    if (type(e) == USB_CONTROL)
        return (e->bank == BANK_SETUP || e->bank == BANK_OUT) && e->at < e->count[0];
    return !is_in(e) && !e->stall && (e->flags & UEINTX_FIFOCON) && e->at < e->count[e->cpu_bank];
}

static int may_write(const usb_endpoint_t *e)
{
    if (!works(e) || e->at >= e->size)
        return 0;
    if (type(e) == USB_CONTROL)
        return e->bank == BANK_FREE && (e->flags & UEINTX_TXINI);
    return is_in(e) && !e->stall && (e->flags & UEINTX_FIFOCON);
}

static unsigned byte_count(const usb_endpoint_t *e)
{
    int bank = type(e) == USB_CONTROL ? 0 : e->cpu_bank;
    int incoming = type(e) == USB_CONTROL ? e->bank == BANK_SETUP || e->bank == BANK_OUT : !is_in(e);
    if (!incoming)
        return e->at;
    return type(e) == USB_CONTROL || (e->flags & UEINTX_FIFOCON) ? e->count[bank] - e->at : 0;
}

uint8_t usb_endpoint_read(usb_device_t *u, avr_io_addr_t reg)
{
    usb_endpoint_t *e = usb_selected(u);
    if (!e)
        return 0;
    int control = type(e) == USB_CONTROL;
    switch (reg) {
    case UEINTX:
        return e->flags | (!control && (may_read(e) || may_write(e)) ? UEINTX_RWAL : 0);
    case UECONX:
        return (e->enabled ? UECONX_EPEN : 0) | (e->stall ? UECONX_STALLRQ : 0);
    case UECFG0X:
        return e->cfg0;
    case UECFG1X:
        return e->cfg1;
    case UESTA0X:
        return (e->cfg_ok ? 0x80 : 0) | e->errors | (control || is_in(e) ? e->toggle : e->seen_toggle) << 2
            | (control ? e->bank != BANK_FREE : e->busy);
    case UESTA1X:
        return (e->read_request ? 4 : 0) | (control ? 0 : e->cpu_bank);
    case UEIENX:
        return e->ien;
    case UEBCLX:
        return byte_count(e) & 0xff;
    case UEBCHX:
        return byte_count(e) >> 8;
    case UEDATX:
        if (may_read(e))
            return *cell(u, e, control ? 0 : e->cpu_bank, e->at++);
        u->fifo_errors++; /* what the chip gives is not said; 0 shows the mistake */
    }
    return 0;
}

void usb_endpoint_write(usb_device_t *u, avr_io_addr_t reg, uint8_t value)
{
    usb_endpoint_t *e = usb_selected(u);
    if (!e)
        return;
    switch (reg) {
    case UEINTX:
        if (works(e))
            write_flags(u, e, value);
        return;
    case UECONX:
        if (value & UECONX_RSTDT)
            e->toggle = e->expected = 0;
        if (value & UECONX_STALLRQ)
            e->stall = 1;
        if (value & UECONX_STALLRQC)
            e->stall = 0;
        if ((value & UECONX_EPEN) && !e->enabled) {
            e->enabled = 1;
            restart(u, e);
        } else if (!(value & UECONX_EPEN)) {
            disable(u, e);
        }
        break;
    case UECFG0X:
        e->cfg0 = value & 0xc1;
        restart(u, e);
        break;
    case UECFG1X:
        e->cfg1 = value & 0x7e;
        if (value & UECFG1X_ALLOC) {
            allocate(u, e);
        } else {
            e->cfg_ok = e->reserved = 0;
            slide(u, e);
        }
        restart(u, e);
        break;
    case UESTA0X:
        e->errors &= value;
        return;
    case UEIENX:
        e->ien = value;
        return;
    case UEDATX:
        if (may_write(e))
            *cell(u, e, type(e) == USB_CONTROL ? 0 : e->cpu_bank, e->at++) = value;
        else
            u->fifo_errors++;
        return;
    default:
        return;
    }
    usb_changed(u);
}

/* ---- transactions ---- */

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
    usb_endpoint_t *e = &u->endpoints[endpoint];
    unsigned own = u->udaddr & 0x80 ? u->udaddr & 0x7f : 0;
    f->endpoint = NULL;
    f->answer = USB_NONE;
    if (!usb_device_pulls_up(u) || !usb_clocked(u) || address != own
        || (int)endpoint >= usb_endpoint_count(u) || !works(e) || type(e) == USB_ISOCHRONOUS)
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
