/* See usb_device.h: the general registers of the controller, and its resets. */
#include "usb_endpoint.h"

#include <stdlib.h>
#include <string.h>

#include "sim_interrupts.h"
#include "usb_registers.h"

static void write_pll(usb_device_t *u, uint8_t value)
{
    uint8_t mask = u->is_u2 ? 0x1e : 0x12, before = u->pllcsr;
    u->pllcsr = (value & mask) | (value & PLLE ? before & PLOCK : 0);
    if ((u->pllcsr ^ before) & mask)
        usb_start_pll(u);
}

static void reset_controller(usb_device_t *u)
{
    u->udcon = DETACH;
    u->udint = u->udien = u->udaddr = u->uenum = u->uerst = 0;
    u->frame = u->suspended = 0;
    memset(u->endpoints, 0, sizeof u->endpoints);
    u->flight.endpoint = NULL;
}

static void write_udint(usb_device_t *u, uint8_t value)
{
    if (!usb_clocked(u))
        value |= WAKEUPI; /* the clock must run before it can be cleared */
    u->udint &= value;
}

static void write_udcon(usb_device_t *u, uint8_t value)
{
    uint8_t was = u->udcon;
    u->udcon = (value & (u->is_u2 ? 5 : 13)) | (was & RMWKUP);
    if (!(value & RMWKUP) || (was & RMWKUP) || !u->suspended || !u->was_awake)
        return; /* there is nobody to wake up */
    u->udcon |= RMWKUP;
    usb_raise(u, UPRSMI);
    u->on_wakeup(u->param);
}

static void write_register(avr_t *avr, avr_io_addr_t reg, uint8_t value, void *param)
{
    usb_device_t *u = param;
    (void)avr;
    switch (reg) {
    case PLLCSR:
        write_pll(u, value);
        break;
    case UHWCON:
        u->uhwcon = value & UVREGE;
        break;
    case USBCON:
        u->usbcon = value & (u->is_u2 ? USBE | FRZCLK : USBE | FRZCLK | OTGPADE | VBUSTE);
        if (!(value & USBE))
            reset_controller(u);
        break;
    case USBINT:
        u->usbint &= value;
        break;
    default:
        if (!(u->usbcon & USBE))
            return;
        if (reg == UDCON)
            write_udcon(u, value);
        else if (reg == UDINT)
            write_udint(u, value);
        else if (reg == UDIEN)
            u->udien = value & UD_EVENTS;
        else if (!usb_clocked(u))
            return;
        else if (reg == UDADDR)
            u->udaddr = value | (u->udaddr & 0x80); /* ADDEN cannot be cleared */
        else if (reg == UENUM)
            u->uenum = value & 7;
        else if (reg == UERST)
            usb_endpoint_hold(u, u->uerst = value & 0x7f);
        else
            usb_endpoint_write(u, reg, value);
        if (reg >= UEINTX && reg != UERST) { /* what the host may see has been told */
            usb_levels(u);
            return;
        }
    }
    usb_changed(u);
}

static uint8_t value_of(usb_device_t *u, avr_io_addr_t reg)
{
    switch (reg) {
    case PLLCSR: return u->pllcsr;
    case UHWCON: return u->uhwcon;
    case USBCON: return u->usbcon;
    case USBSTA: return 8 | usb_vbus_seen(u);
    case USBINT: return u->usbint;
    case UDCON: return u->udcon;
    case UDINT: return u->udint;
    case UDIEN: return u->udien;
    }
    if (!usb_clocked(u))
        return 0; /* the data sheet only says that these are not accessible */
    switch (reg) {
    case UDADDR: return u->udaddr;
    case UDFNUML: return u->frame & 0xff;
    case UDFNUMH: return u->frame >> 8;
    case UDMFN: return 0; /* no SOF is ever damaged */
    case UENUM: return u->uenum;
    case UERST: return u->uerst;
    case UEINT: return usb_endpoint_interrupts(u);
    }
    return usb_endpoint_read(u, reg);
}

static uint8_t read_register(avr_t *avr, avr_io_addr_t reg, void *param)
{
    return avr->data[reg] = value_of(param, reg);
}

static void reset(struct avr_io_t *io)
{
    /* simavr hands over the port; the hook of one of its registers knows us. */
    usb_device_t *u = io->avr->io[AVR_DATA_TO_IO(UEINTX)].w.param;
    io->avr->data[PLLFRQ] = u->is_u2 ? 0 : 4;
    if (u->keep) {
        usb_rearm(u);
        usb_levels(u);
    } else {
        usb_stop(u);
        u->uhwcon = u->usbint = u->pllcsr = 0;
        u->was_vbus = u->was_awake = 0;
        u->usbcon = FRZCLK;
        reset_controller(u);
        usb_levels(u);
    }
    u->on_reset(u->param);
}

/* RSTCPU: simavr cannot be reset in the midst of its timers, so it is done instead of the next burst. */
static void reset_cpu(avr_t *avr)
{
    usb_device_t *u = avr->io[AVR_DATA_TO_IO(UEINTX)].w.param;
    avr->run = u->run;
    u->keep = 1;
    avr_reset(avr);
    u->keep = 0;
    if (u->is_u2)
        avr->data[MCUSR] |= 0x20; /* USBRF */
}

void usb_device_bus_reset(usb_device_t *u, int end)
{
    u->signalled = !end;
    usb_traffic(u);
    if (!end || !usb_device_pulls_up(u) || !usb_clocked(u))
        return;
    u->udaddr = 0;
    usb_endpoints_bus_reset(u);
    usb_raise(u, EORSTI);
    if (u->udcon & (u->is_u2 ? 4 : 8)) {
        u->run = u->avr->run;
        u->avr->run = reset_cpu;
        u->avr->run_cycle_count = 0;
    }
}

static avr_int_vector_t *take_vector(usb_device_t *u, int number, int bit)
{
    avr_int_table_t *table = &u->avr->interrupts;
    for (int i = 0; i < table->vector_count; i++)
        if (table->vector[i]->vector == number) {
            table->vector[i]->enable = (avr_regbit_t){.reg = LEVELS, .bit = bit, .mask = 1};
            avr_irq_register_notify(table->vector[i]->irq + AVR_INT_IRQ_RUNNING, usb_on_running, u);
            return table->vector[i];
        }
    abort(); /* simavr registers both with its port */
}

static void hook(usb_device_t *u, avr_io_addr_t reg)
{
    u->avr->io[AVR_DATA_TO_IO(reg)].r.c = read_register;
    u->avr->io[AVR_DATA_TO_IO(reg)].r.param = u;
    u->avr->io[AVR_DATA_TO_IO(reg)].w.c = write_register;
    u->avr->io[AVR_DATA_TO_IO(reg)].w.param = u;
}

void usb_device_attach(usb_device_t *u, avr_t *avr, avr_usb_t *port)
{
    u->avr = avr;
    u->gen = take_vector(u, port->usb_gen_vect, 0);
    u->com = take_vector(u, port->usb_com_vect, 1);
    for (avr_io_addr_t reg = UHWCON; reg <= UEINT; reg++) {
        avr->io[AVR_DATA_TO_IO(reg)].r.c = NULL; /* simavr's model must not run as well */
        avr->io[AVR_DATA_TO_IO(reg)].w.c = NULL;
    }
    hook(u, PLLCSR);
    for (avr_io_addr_t reg = u->is_u2 ? USBCON : UHWCON; reg <= (u->is_u2 ? USBCON : USBINT); reg++)
        hook(u, reg);
    for (avr_io_addr_t reg = UDCON; reg <= UEINT; reg++)
        if (reg != UDMFN + 1 && !(u->is_u2 && reg == UEBCHX))
            hook(u, reg);
    port->io.reset = reset;
    reset(&port->io);
}
