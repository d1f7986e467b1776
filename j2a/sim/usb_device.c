/* See usb_device.h: clock, bus events, interrupts and general registers of the controller. */
#include "usb_device.h"

#include <stdlib.h>
#include <string.h>

#include "sim_cycle_timers.h"
#include "sim_interrupts.h"

enum { PLLCSR = 0x49, PLLFRQ = 0x52, CLKPR = 0x61, REGCR = 0x63, MCUSR = 0x54 };
enum { UHWCON = 0xd7, USBCON, USBSTA, USBINT, UDCON = 0xe0, UDINT, UDIEN, UDADDR, UDFNUML, UDFNUMH, UDMFN };
enum { UEINTX = 0xe8, UENUM, UERST, UEBCHX = 0xf3, UEINT };
/* Reserved on all these chips: the levels of the two interrupts, where simavr looks for enable bits. */
enum { LEVELS = 0xff };
enum { USBE = 0x80, FRZCLK = 0x20, OTGPADE = 0x10, VBUSTE = 1, UVREGE = 1, PLLE = 2, PLOCK = 1 };
enum { DETACH = 1, RMWKUP = 2, LSM = 4 };
enum { SUSPI = 1, SOFI = 4, EORSTI = 8, WAKEUPI = 0x10, EORSMI = 0x20, UPRSMI = 0x40, UD_EVENTS = 0x7d };
static const double PLL_LOCK_S = 0.002; /* "several ms" on some chips of the family, 0.1 ms on others */
static const double SUSPEND_S = 0.003;

/* ---- clock and power ---- */

/* The reference of the PLL must be 8 MHz and what it makes 48 MHz; CLKPR divides the clock of the CPU only. */
static int pll_is_right(const usb_device_t *u)
{
    const uint8_t *data = u->avr->data;
    double crystal = (double)u->avr->frequency * (1 << (data[CLKPR] & 15));
    if (u->is_u2)
        return crystal == ((u->pllcsr & 0x1c) == 4 ? 16e6 : (u->pllcsr & 0x1c) == 0 ? 8e6 : 0);
    int frq = data[PLLFRQ], output = frq & 15, half = (frq >> 6) & 1;
    if (frq & 0x80) /* PINMUX: the internal 8 MHz oscillator */
        crystal = u->pllcsr & 0x10 ? 0 : 8e6;
    return crystal == (u->pllcsr & 0x10 ? 16e6 : 8e6) && output == (half ? 10 : 4);
}

int usb_clocked(const usb_device_t *u)
{
    return (u->usbcon & USBE) && !(u->usbcon & FRZCLK) && (u->pllcsr & PLOCK) && pll_is_right(u);
}

static int vbus_seen(const usb_device_t *u)
{
    return (u->usbcon & USBE) && (u->usbcon & OTGPADE) && u->vbus;
}

/* The pads need their regulator: boards that feed them from outside are not modelled. A U2 cannot see VBUS. */
int usb_device_pulls_up(const usb_device_t *u)
{
    if (!(u->usbcon & USBE) || (u->udcon & DETACH))
        return 0;
    if (u->is_u2)
        return !(u->avr->data[REGCR] & 1);
    return vbus_seen(u) && (u->uhwcon & UVREGE) && !(u->udcon & LSM);
}

/* ---- interrupts ---- */

static uint8_t endpoint_interrupts(const usb_device_t *u)
{
    uint8_t all = 0;
    for (int i = 0; i < usb_endpoint_count(u); i++)
        all |= usb_endpoint_interrupt(&u->endpoints[i]) << i;
    return all;
}

static void level(usb_device_t *u, avr_int_vector_t *v, int on)
{
    int was = avr_regbit_get(u->avr, v->enable);
    if (on)
        avr_regbit_set(u->avr, v->enable);
    else
        avr_regbit_clear(u->avr, v->enable); /* one that is pending already is then dropped */
    if (on && !v->pending)
        avr_raise_interrupt(u->avr, v);
    else if (on && !was)
        avr_raise_irq(v->irq + AVR_INT_IRQ_PENDING, 1);
}

/* Without clock only WAKEUPI and VBUSTI interrupt. */
void usb_levels(usb_device_t *u)
{
    int clocked = usb_clocked(u);
    uint8_t events = u->udint & u->udien & (clocked ? UD_EVENTS : WAKEUPI);
    level(u, u->gen, (u->usbcon & USBE) && (events || (u->usbint & u->usbcon & VBUSTE)));
    level(u, u->com, clocked && endpoint_interrupts(u));
}

/* A handler that returns without serving its flag is entered again, as on the chip. */
static void on_running(struct avr_irq_t *irq, uint32_t running, void *param)
{
    (void)irq;
    if (!running)
        usb_levels(param);
}

static void raise(usb_device_t *u, uint8_t event)
{
    u->udint |= event;
    usb_levels(u);
}

/* ---- suspend ---- */

static avr_cycle_count_t on_idle(avr_t *avr, avr_cycle_count_t when, void *param)
{
    usb_device_t *u = param;
    uint64_t due = u->idle_since + (uint64_t)(SUSPEND_S * avr->frequency);
    u->idle_at = 0;
    if (!u->was_awake || u->suspended)
        return 0;
    if (u->signalled)
        return u->idle_at = when + (uint64_t)(SUSPEND_S * avr->frequency);
    if (when < due)
        return u->idle_at = due;
    u->suspended = 1;
    raise(u, SUSPI);
    return 0;
}

static void wait_for_idle(usb_device_t *u)
{
    if (u->idle_at || !u->was_awake)
        return;
    u->idle_at = u->avr->cycle + (uint64_t)(SUSPEND_S * u->avr->frequency);
    avr_cycle_timer_register(u->avr, u->idle_at - u->avr->cycle, on_idle, u);
}

/* Something other than the idle state is on the lines. WAKEUPI comes even when the bus was not suspended:
 * firmware has to clear it before it enables its interrupt. It clears no SUSPI, nor the reverse. */
static void traffic(usb_device_t *u)
{
    if (!usb_device_pulls_up(u))
        return;
    u->idle_since = u->avr->cycle;
    u->suspended = 0;
    wait_for_idle(u);
    if (!(u->udint & WAKEUPI))
        raise(u, WAKEUPI);
}

/* After anything that may change clock, VBUS or pull-up. */
void usb_changed(usb_device_t *u)
{
    int vbus = vbus_seen(u), awake = usb_device_pulls_up(u) && usb_clocked(u);
    if (!u->is_u2 && vbus != u->was_vbus)
        u->usbint |= 1;
    u->was_vbus = vbus;
    if (awake && !u->was_awake) {
        u->was_awake = 1;
        u->suspended = 0;
        u->idle_since = u->avr->cycle;
        wait_for_idle(u);
    }
    u->was_awake = awake;
    usb_levels(u);
    u->on_change(u->param);
}

/* ---- what the host does ---- */

void usb_device_vbus(usb_device_t *u, int on)
{
    u->driven = 0;
    u->vbus = on;
    u->signalled = 0;
    usb_changed(u);
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
    u->driven = !end;
    u->signalled = !end;
    traffic(u);
    if (!end || !usb_device_pulls_up(u) || !usb_clocked(u))
        return;
    u->udaddr = 0;
    usb_endpoints_bus_reset(u);
    raise(u, EORSTI);
    if (u->udcon & (u->is_u2 ? 4 : 8)) {
        u->run = u->avr->run;
        u->avr->run = reset_cpu;
        u->avr->run_cycle_count = 0;
    }
}

void usb_device_resume(usb_device_t *u, int end)
{
    u->driven = !end;
    u->signalled = !end;
    traffic(u);
    if (end && usb_device_pulls_up(u) && usb_clocked(u)) {
        u->udcon &= ~RMWKUP;
        raise(u, EORSMI);
    }
}

void usb_device_sof(usb_device_t *u, unsigned frame)
{
    traffic(u);
    if (usb_device_pulls_up(u) && usb_clocked(u)) {
        u->frame = frame;
        raise(u, SOFI);
    }
}

/* ---- registers ---- */

static avr_cycle_count_t on_lock(avr_t *avr, avr_cycle_count_t when, void *param)
{
    usb_device_t *u = param;
    (void)avr;
    (void)when;
    u->pll_at = 0;
    if (pll_is_right(u)) {
        u->pllcsr |= PLOCK;
        usb_changed(u);
    }
    return 0;
}

/* `at` is set before the chip's reset drops all timers; this arms them again. */
static void rearm(usb_device_t *u, uint64_t at, avr_cycle_timer_t timer)
{
    if (at)
        avr_cycle_timer_register(u->avr, at > u->avr->cycle ? at - u->avr->cycle : 1, timer, u);
}

static void write_pll(usb_device_t *u, uint8_t value)
{
    uint8_t mask = u->is_u2 ? 0x1e : 0x12, before = u->pllcsr;
    u->pllcsr = (value & mask) | (value & PLLE ? before & PLOCK : 0);
    if ((u->pllcsr ^ before) & mask) {
        u->pllcsr &= ~PLOCK;
        avr_cycle_timer_cancel(u->avr, on_lock, u);
        u->pll_at = value & PLLE ? u->avr->cycle + (uint64_t)(PLL_LOCK_S * u->avr->frequency) : 0;
        rearm(u, u->pll_at, on_lock);
    }
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
    raise(u, UPRSMI);
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
    case USBSTA: return 8 | vbus_seen(u);
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
    case UEINT: return endpoint_interrupts(u);
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
        rearm(u, u->pll_at, on_lock);
        rearm(u, u->idle_at, on_idle);
        usb_levels(u);
    } else {
        avr_cycle_timer_cancel(u->avr, on_lock, u);
        avr_cycle_timer_cancel(u->avr, on_idle, u);
        u->pll_at = u->idle_at = 0;
        u->uhwcon = u->usbint = u->pllcsr = 0;
        u->was_vbus = u->was_awake = 0;
        u->usbcon = FRZCLK;
        reset_controller(u);
        usb_levels(u);
    }
    u->on_reset(u->param);
}

static avr_int_vector_t *take_vector(usb_device_t *u, int number, int bit)
{
    avr_int_table_t *table = &u->avr->interrupts;
    for (int i = 0; i < table->vector_count; i++)
        if (table->vector[i]->vector == number) {
            table->vector[i]->enable = (avr_regbit_t){.reg = LEVELS, .bit = bit, .mask = 1};
            avr_irq_register_notify(table->vector[i]->irq + AVR_INT_IRQ_RUNNING, on_running, u);
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
