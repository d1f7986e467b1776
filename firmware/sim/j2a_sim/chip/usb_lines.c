/* See usb_device.h: the controller's clock and pull-up, its interrupts, and events on the bus. */
#include "usb_device.h"

#include "sim_cycle_timers.h"
#include "sim_interrupts.h"
#include "usb_registers.h"

static const double PLL_LOCK_S = 0.002; /* "several ms" on some chips of the family, 0.1 ms on others */
static const double SUSPEND_S = 0.003;

/* ---- clock and power ---- */

/* The PLL needs 8 MHz and must make 48 MHz; CLKPR divides the clock of the CPU only. */
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

int usb_vbus_seen(const usb_device_t *u)
{
    return (u->usbcon & USBE) && (u->usbcon & OTGPADE) && u->vbus;
}

/* The pads need their regulator: boards that feed them from outside are not modelled. A U2 knows no VBUS. */
int usb_device_pulls_up(const usb_device_t *u)
{
    if (!(u->usbcon & USBE) || (u->udcon & DETACH))
        return 0;
    if (u->is_u2)
        return !(u->avr->data[REGCR] & 1);
    return usb_vbus_seen(u) && (u->uhwcon & UVREGE) && !(u->udcon & LSM);
}

/* In the order of _usb_bus.port.LACKS. */
int usb_device_lacks(const usb_device_t *u)
{
    if ((u->pllcsr & PLLE) && !u->pll_at && !((u->pllcsr & PLOCK) && pll_is_right(u)))
        return 1;
    if (!(u->usbcon & USBE))
        return 2;
    return u->udcon & DETACH ? 3 : usb_device_pulls_up(u) ? 0 : 4;
}

/* ---- interrupts ---- */

static int endpoint_interrupt(const usb_endpoint_t *e)
{
    const uint8_t events = UEINTX_TXINI | UEINTX_STALLEDI | UEINTX_RXOUTI | UEINTX_RXSTPI | UEINTX_NAKOUTI
        | UEINTX_NAKINI;
    return (e->flags & e->ien & events) || (e->errors && (e->ien & 0x80));
}

uint8_t usb_endpoint_interrupts(const usb_device_t *u)
{
    uint8_t all = 0;
    for (int i = 0; i < usb_endpoint_count(u); i++)
        all |= endpoint_interrupt(&u->endpoints[i]) << i;
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
    level(u, u->com, clocked && usb_endpoint_interrupts(u));
}

/* A handler that returns without serving its flag is entered again, as on the chip. */
void usb_on_running(struct avr_irq_t *irq, uint32_t running, void *param)
{
    (void)irq;
    if (!running)
        usb_levels(param);
}

void usb_raise(usb_device_t *u, uint8_t event)
{
    if (u->suspend_flags == USB_FLAGS_EXCLUSIVE && (event & (SUSPI | WAKEUPI)))
        u->udint &= ~(SUSPI | WAKEUPI);
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
    usb_raise(u, SUSPI);
    return 0;
}

static void wait_for_idle(usb_device_t *u)
{
    if (u->idle_at || !u->was_awake)
        return;
    u->idle_at = u->avr->cycle + (uint64_t)(SUSPEND_S * u->avr->frequency);
    avr_cycle_timer_register(u->avr, u->idle_at - u->avr->cycle, on_idle, u);
}

/* WAKEUPI comes even when the bus was not suspended: firmware has to clear it before it enables its
 * interrupt. */
void usb_traffic(usb_device_t *u)
{
    if (!usb_device_pulls_up(u))
        return;
    u->idle_since = u->avr->cycle;
    u->suspended = 0;
    wait_for_idle(u);
    if (!(u->udint & WAKEUPI))
        usb_raise(u, WAKEUPI);
}

/* After anything that may change clock, VBUS or pull-up. */
void usb_changed(usb_device_t *u)
{
    int vbus = usb_vbus_seen(u), awake = usb_device_pulls_up(u) && usb_clocked(u);
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

/* ---- timers ---- */

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

static void rearm(usb_device_t *u, uint64_t at, avr_cycle_timer_t timer)
{
    if (at)
        avr_cycle_timer_register(u->avr, at > u->avr->cycle ? at - u->avr->cycle : 1, timer, u);
}

void usb_start_pll(usb_device_t *u)
{
    avr_cycle_timer_cancel(u->avr, on_lock, u);
    u->pllcsr &= ~PLOCK;
    u->pll_at = u->pllcsr & PLLE ? u->avr->cycle + (uint64_t)(PLL_LOCK_S * u->avr->frequency) : 0;
    rearm(u, u->pll_at, on_lock);
}

void usb_rearm(usb_device_t *u)
{
    rearm(u, u->pll_at, on_lock);
    rearm(u, u->idle_at, on_idle);
}

void usb_stop(usb_device_t *u)
{
    avr_cycle_timer_cancel(u->avr, on_lock, u);
    avr_cycle_timer_cancel(u->avr, on_idle, u);
    u->pll_at = u->idle_at = 0;
}

/* ---- what the host does ---- */

void usb_device_vbus(usb_device_t *u, int on)
{
    u->vbus = on;
    u->signalled = 0;
    usb_changed(u);
}

void usb_device_resume(usb_device_t *u, int end)
{
    u->signalled = !end;
    usb_traffic(u);
    if (end && usb_device_pulls_up(u) && usb_clocked(u)) {
        u->udcon &= ~RMWKUP;
        usb_raise(u, EORSMI);
    }
}

void usb_device_sof(usb_device_t *u, unsigned frame)
{
    usb_traffic(u);
    if (usb_device_pulls_up(u) && usb_clocked(u)) {
        u->frame = frame;
        usb_raise(u, SOFI);
    }
}
