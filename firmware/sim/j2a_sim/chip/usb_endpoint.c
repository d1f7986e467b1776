/* See usb_endpoint.h: memory and registers of the endpoints. */
#include <stddef.h>

#include "usb_endpoint.h"

enum { UEINTX = 0xe8, UECONX = 0xeb, UECFG0X, UECFG1X, UESTA0X, UESTA1X, UEIENX, UEDATX, UEBCLX, UEBCHX };
enum { CLEARABLE = UEINTX_NAKINI | UEINTX_NAKOUTI | UEINTX_STALLEDI };

/* NULL: UENUM is out of range. */
static usb_endpoint_t *selected(usb_device_t *u)
{
    return u->uenum < usb_endpoint_count(u) ? &u->endpoints[u->uenum] : NULL;
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

/* The data sheet (22.4) lets endpoint 0 stay configured; chips take EPEN, ALLOC and memory from it as well. */
void usb_endpoints_bus_reset(usb_device_t *u)
{
    for (int i = 0; i < usb_endpoint_count(u); i++) {
        usb_endpoint_t *e = &u->endpoints[i];
        e->cfg1 &= ~UECFG1X_ALLOC;
        e->cfg_ok = e->reserved = 0;
        disable(u, e);
    }
    u->flight.endpoint = NULL;
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

/* What UEBCX counts beside the bank of the CPU, and in a SETUP, the data sheet leaves open. */
static unsigned byte_count(const usb_device_t *u, const usb_endpoint_t *e)
{
    if (type(e) == USB_CONTROL && e->bank == BANK_SETUP && u->counting >= USB_COUNTS_SETUP_AS_0)
        return u->counting == USB_COUNTS_SETUP_AS_0 ? 0 : e->count[0];
    int bank = type(e) == USB_CONTROL ? 0 : e->cpu_bank;
    int incoming = type(e) == USB_CONTROL ? e->bank == BANK_SETUP || e->bank == BANK_OUT : !is_in(e);
    if (!incoming) {
        unsigned others = 0;
        for (int i = 0; i < e->busy && u->counting == USB_COUNTS_BANKS; i++)
            others += e->count[i ? next_bank(e, e->bus_bank) : e->bus_bank];
        return e->at + others;
    }
    return type(e) == USB_CONTROL || (e->flags & UEINTX_FIFOCON) ? e->count[bank] - e->at : 0;
}

uint8_t usb_endpoint_read(usb_device_t *u, avr_io_addr_t reg)
{
    usb_endpoint_t *e = selected(u);
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
        return byte_count(u, e) & 0xff;
    case UEBCHX:
        return byte_count(u, e) >> 8;
    case UEDATX:
        if (may_read(e))
            return *cell(u, e, control ? 0 : e->cpu_bank, e->at++);
        u->fifo_errors++; /* what the chip gives is not said; 0 shows the mistake */
    }
    return 0;
}

void usb_endpoint_write(usb_device_t *u, avr_io_addr_t reg, uint8_t value)
{
    usb_endpoint_t *e = selected(u);
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
