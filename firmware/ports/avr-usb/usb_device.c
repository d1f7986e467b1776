/* The controller and the bus, see usb.h: start, reset, suspend, wake-up and plug. In: the interrupt USB_GEN.
 * Out: usb_trouble, and a controller in the state that the bus asks for.
 * Rule: while the clock of the controller stands, only PLLCSR and the registers up to UDIEN are touched. */
#include "usb.h"

#include <avr/interrupt.h>
#include <avr/power.h>
#include <avr/sleep.h>
#include <util/delay_basic.h>

#if F_CPU == 16000000
#ifdef PINDIV
#define PLL_ON (_BV(PINDIV) | _BV(PLLE))
#else
#define PLL_ON (_BV(PLLP0) | _BV(PLLE))
#endif
#elif F_CPU == 8000000
#define PLL_ON _BV(PLLE)
#else
#error "F_CPU (make FREQ=) must be 16000000 or 8000000, the crystals that USB can be clocked from"
#endif

#ifdef OTGPADE /* there is a pin that watches VBUS */
#define USB_ON (_BV(USBE) | _BV(OTGPADE) | _BV(VBUSTE))
#else
#define USB_ON _BV(USBE)
#endif

volatile uint8_t usb_trouble = USB_UNCONFIGURED;

/* Lets the clock go on. */
static void wake(void) {
#if J2A_USB_SLEEP
    uint16_t turns = 0; /* some 30 ms at most; the PLL takes far less */
    PLLCSR = PLL_ON;
    while (!(PLLCSR & _BV(PLOCK)) && --turns != 0) {
    }
#endif
    USBCON = USB_ON;
    UDINT = (uint8_t)~(_BV(WAKEUPI) | _BV(SUSPI));
#if J2A_PORT_FRAMES
    UDIEN = _BV(EORSTE) | _BV(SUSPE) | _BV(EORSME) | _BV(SOFE);
#else
    UDIEN = _BV(EORSTE) | _BV(SUSPE) | _BV(EORSME);
#endif
    usb_trouble &= (uint8_t)~USB_SUSPENDED;
}

static void suspend(void) {
    UDINT = (uint8_t)~(_BV(WAKEUPI) | _BV(SUSPI));
    UDIEN = _BV(EORSTE) | _BV(WAKEUPE);
    USBCON = USB_ON | _BV(FRZCLK);
#if J2A_USB_SLEEP
    PLLCSR = 0;
#endif
    usb_trouble |= USB_SUSPENDED;
}

/* A board with power of its own must not pull the line up while nobody is at the other end of the cable. */
static void follow_vbus(void) {
#ifdef OTGPADE
    USBINT = 0;
    if (!(USBSTA & _BV(VBUS))) {
        UDCON = _BV(DETACH);
        usb_configure(false);
        return;
    }
#endif
    UDCON = 0;
}

void usb_start(void) {
    cli();
    /* A boot loader may have left the watchdog on, and the chip runs at an eighth of its clock as it is
     * sold. */
    avr_reset_begin(); /* WDRF keeps the watchdog on */
    /* WDCE allows the change for four cycles, which C does not promise to keep to. */
    __asm__ volatile("wdr\n\tsts %0, %1\n\tsts %0, __zero_reg__"
                     :: "n"(_SFR_MEM_ADDR(WDTCSR)), "r"((uint8_t)(_BV(WDCE) | _BV(WDE))));
    clock_prescale_set(clock_div_1);
#ifdef UHWCON
    UHWCON = _BV(UVREGE);
#endif
    USBCON = 0; /* the controller as after a reset */
    USBCON = USB_ON | _BV(FRZCLK);
#ifdef PLLFRQ
    PLLFRQ = _BV(PDIV2); /* 48 MHz */
#endif
    PLLCSR = PLL_ON;
    while (!(PLLCSR & _BV(PLOCK))) {
    }
    /* Who jumped here without a reset, a boot loader say, may have been on the bus. A host has to notice
     * that it is gone: 10 ms. */
    _delay_loop_2(F_CPU / 4 / 100);
    wake();
    follow_vbus();
}

void usb_events(void) {
    uint8_t flags;
#ifdef OTGPADE
    if (USBINT & _BV(VBUSTI)) {
        wake();
        follow_vbus();
    }
#endif
    flags = UDINT & UDIEN;
    if (flags & _BV(WAKEUPI))
        wake();
    if (flags & _BV(EORSTI)) {
        UDINT = (uint8_t)~(_BV(EORSTI) | _BV(SUSPI));
        usb_configure(false);
        usb_control_reset();
    } else if (flags & _BV(EORSMI)) { /* interrupts may have been off meanwhile: that suspend is over */
        UDINT = (uint8_t)~(_BV(EORSMI) | _BV(SUSPI));
    } else if (flags & _BV(SUSPI)) {
        suspend();
    }
}

ISR(USB_GEN_vect) {
#if J2A_PORT_FRAMES
    if (UDINT & UDIEN & _BV(SOFI)) /* first, because it is about time */
        usb_frame_started();
#endif
    usb_events();
}

#if J2A_USB_SLEEP
void usb_sleep(void) {
    if (!(SREG & _BV(SREG_I)))
        return; /* nothing would wake it */
    set_sleep_mode(SLEEP_MODE_PWR_DOWN);
    cli();
    if (usb_trouble & USB_SUSPENDED) {
        const uint8_t timer = TIMSK1;
        TIMSK1 = 0; /* chips take more current while an interrupt is due that cannot wake them */
        sleep_enable();
        sei(); /* the next instruction comes before any interrupt */
        sleep_cpu();
        sleep_disable();
        TIMSK1 = timer;
    }
    sei();
}
#endif
