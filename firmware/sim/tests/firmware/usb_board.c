/* A board for the tests of what uses the simulated USB: it sends each packet of endpoint 2 back on
 * endpoint 1, keeps what comes on endpoint 3, and does odd things when a vendor request asks for
 * them. SERIAL (a letter as a number) makes its serial number. For the ATmega32U4 at 16 MHz;
 * polled, no interrupts. KIND is that of endpoints 1 and 2. With NEEDS_BYTES it gives a bank back only
 * when it has read a byte of it; with SUSPENDS it freezes its clock in suspend and leaves it to the
 * hardware to clear SUSPI when the bus wakes up. */
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/pgmspace.h>
#include <avr/sleep.h>

#ifndef SERIAL
#define SERIAL 'A'
#endif
#ifndef CLASS
#define CLASS 0xFF
#endif
#ifndef KIND
#define KIND 2
#endif
#ifndef NEEDS_BYTES
#define NEEDS_BYTES 0
#endif
#ifndef SUSPENDS
#define SUSPENDS 0
#endif
#ifndef DETACHED
#define DETACHED 0
#endif

/* Bit 2 of an IN endpoint's UEINTX, which has another name there, would kill a bank. */
#define KILLBK RXOUTI

enum { PACKET = 64, IN = 1, OUT = 2, SYNC = 3 };

/* Vendor requests to the device; the argument is wValue. */
enum { DO_HALT = 1, DO_HOLD, DO_DETACH, DO_STOP, DO_KEEP, DO_BURST };

static const uint8_t PROGMEM device[] = {
    18, 1, 0x00, 0x02, 0, 0, 0, PACKET, 0x66, 0x66, 0xFE, 0xCA, 0x34, 0x12, 1, 2, 3, 1};
static const uint8_t PROGMEM configuration[] = {
    9, 2, 48, 0, 2, 1, 0, 0x80, 50,
    9, 4, 0, 0, 2, CLASS, 0x12, 0xEF, 0,
    7, 5, 0x80 | IN, KIND, PACKET, 0, KIND == 3,
    7, 5, OUT, KIND, PACKET, 0, KIND == 3,
    9, 4, 1, 0, 1, 0xFF, 0x34, 0x01, 4,
    7, 5, SYNC, 3, 16, 0, 1};
static const uint8_t PROGMEM languages[] = {4, 3, 0x09, 0x04};
static const uint8_t PROGMEM maker[] = {8, 3, 'J', 0, '2', 0, 'A', 0};
static const uint8_t PROGMEM product[] = {10, 3, 'E', 0, 'c', 0, 'h', 0, 'o', 0};
static const uint8_t PROGMEM serial[] = {8, 3, 'S', 0, 'N', 0, SERIAL, 0};
static const uint8_t PROGMEM sync[] = {16, 3, 'S', 0, 'y', 0, 'n', 0, 'c', 0, 'U', 0, 'S', 0, 'B', 0};
static const struct { const uint8_t *at; } PROGMEM strings[] = {
    {languages}, {maker}, {product}, {serial}, {sync}};

static uint8_t configured, held, kept[16];
static uint16_t burst;
uint8_t sync_packet[16], sync_length;

static uint8_t was_reset(void) { return UDINT & _BV(EORSTI); }

static void acknowledge(void)
{
    UEINTX = (uint8_t)~_BV(TXINI);
    while (!(UEINTX & _BV(TXINI)) && !was_reset()) { }
}

static void reply(const uint8_t *from, uint8_t in_flash, uint8_t n, uint16_t asked)
{
    if (asked < n)
        n = asked;
    while (!(UEINTX & _BV(TXINI)))
        if (was_reset())
            return;
    for (; n; n--, from++)
        UEDATX = in_flash ? pgm_read_byte(from) : *from;
    UEINTX = (uint8_t)~_BV(TXINI);
    while (!(UEINTX & _BV(RXOUTI)))
        if (was_reset() || UEINTX & _BV(RXSTPI))
            return;
    UEINTX = (uint8_t)~_BV(RXOUTI);
}

static void open_endpoint(uint8_t number, uint8_t kind, uint8_t size)
{
    UENUM = number;
    UECONX = 0;
    UECFG1X = 0;
    UECONX = _BV(EPEN);
    UECFG0X = kind;
    UECFG1X = size;
    UERST = _BV(number);
    UERST = 0;
    UECONX = _BV(EPEN) | _BV(RSTDT);
}

static void configure(uint8_t value)
{
    configured = value;
    burst = 0;
    open_endpoint(IN, KIND << 6 | 1, 3 << 4 | 1 << 2 | _BV(ALLOC));
    open_endpoint(OUT, KIND << 6, 3 << 4 | 1 << 2 | _BV(ALLOC));
    open_endpoint(SYNC, 3 << 6, 1 << 4 | _BV(ALLOC));
    UENUM = 0;
}

static void halt(uint8_t number, uint8_t on)
{
    UENUM = number & 0x0F;
    UECONX = _BV(EPEN) | (on ? _BV(STALLRQ) : _BV(STALLRQC) | _BV(RSTDT));
    UENUM = 0;
}

static void stop(void)
{
    cli();
    set_sleep_mode(SLEEP_MODE_PWR_DOWN);
    sleep_enable();
    sleep_cpu();
}

/* Answers a request; returns 0 for one that it does not know. */
static uint8_t answer(uint8_t type, uint8_t request, uint16_t value, uint16_t index, uint16_t length)
{
    static const uint8_t PROGMEM zeros[2] = {0, 0};
    if (type == 0x80 && request == 6) {
        uint8_t number = value;
        const uint8_t *from;
        if (value >> 8 == 1)
            reply(device, 1, sizeof device, length);
        else if (value >> 8 == 2 && !number)
            reply(configuration, 1, sizeof configuration, length);
        else if (value >> 8 == 3 && number < sizeof strings / sizeof *strings) {
            from = (const uint8_t *)pgm_read_ptr(&strings[number].at);
            reply(from, 1, pgm_read_byte(from), length);
        } else
            return 0;
    } else if (type == 0x00 && request == 5) {
        UDADDR = value;
        acknowledge();
        UDADDR = value | _BV(ADDEN);
    } else if (type == 0x00 && request == 9 && value < 2) {
        configure(value);
        acknowledge();
    } else if (type == 0x80 && request == 8)
        reply(&configured, 0, 1, length);
    else if ((type & 0xFC) == 0x80 && request == 0)
        reply(zeros, 1, 2, length);
    else if (type == 0x01 && request == 11 && !value)
        acknowledge();
    else if (type == 0x02 && (request == 1 || request == 3) && !value && index & 3) {
        halt(index, request == 3);
        acknowledge();
    } else if (type == 0x40 && request == DO_HALT) {
        acknowledge();
        halt(value, 1);
    } else if (type == 0x40 && request == DO_HOLD) {
        held = value;
        acknowledge();
    } else if (type == 0x40 && request == DO_DETACH) {
        acknowledge();
        UDCON |= _BV(DETACH);
    } else if (type == 0x40 && request == DO_STOP) {
        acknowledge();
        stop();
    } else if (type == 0x40 && request == DO_BURST) {
        burst = value;
        acknowledge();
    } else if (type == 0x40 && request == DO_KEEP && length <= sizeof kept) {
        while (!(UEINTX & _BV(RXOUTI)))
            if (was_reset())
                return 1;
        for (uint8_t i = 0; i < length; i++)
            kept[i] = UEDATX;
        UEINTX = (uint8_t)~_BV(RXOUTI);
        acknowledge();
    } else if (type == 0xC0 && request == DO_KEEP)
        reply(kept, 0, sizeof kept, length);
    else
        return 0;
    return 1;
}

static uint16_t word(void)
{
    uint8_t low = UEDATX;
    return low | UEDATX << 8;
}

static void control(void)
{
    uint8_t type = UEDATX, request = UEDATX;
    uint16_t value = word(), index = word(), length = word();
    UEINTX = (uint8_t)~(_BV(RXSTPI) | _BV(RXOUTI));
    if (!answer(type, request, value, index, length))
        UECONX = _BV(STALLRQ) | _BV(EPEN);
}

static void echo(void)
{
    uint8_t packet[PACKET], n = 0;
    UENUM = IN;
    if (held || !(UEINTX & _BV(TXINI)))
        return;
    UENUM = OUT;
    if (!(UEINTX & _BV(RXOUTI)) || (NEEDS_BYTES && !(UEINTX & _BV(RWAL))))
        return;
    UEINTX = (uint8_t)~_BV(RXOUTI);
    while (UEINTX & _BV(RWAL))
        packet[n++] = UEDATX;
    UEINTX = (uint8_t)~_BV(FIFOCON);
    UENUM = IN;
    UEINTX = (uint8_t)~(_BV(TXINI) | _BV(KILLBK));
    for (uint8_t i = 0; i < n; i++)
        UEDATX = packet[i];
    UEINTX = (uint8_t)~(_BV(FIFOCON) | _BV(KILLBK));
}

/* Sends so many bytes, each its distance from the end, in full packets and then no short one. */
static void send_burst(void)
{
    UENUM = IN;
    if (!burst || !(UEINTX & _BV(TXINI)))
        return;
    UEINTX = (uint8_t)~(_BV(TXINI) | _BV(KILLBK));
    for (uint8_t n = 0; n < PACKET && burst; n++)
        UEDATX = --burst;
    UEINTX = (uint8_t)~(_BV(FIFOCON) | _BV(KILLBK));
}

static void take_sync(void)
{
    UENUM = SYNC;
    if (!(UEINTX & _BV(RXOUTI)))
        return;
    UEINTX = (uint8_t)~_BV(RXOUTI);
    sync_length = 0;
    while (UEINTX & _BV(RWAL))
        sync_packet[sync_length++] = UEDATX;
    UEINTX = (uint8_t)~_BV(FIFOCON);
}

static void suspend_events(void)
{
    uint8_t events = UDINT & UDIEN;
    if (events & _BV(SUSPI)) {
        UDIEN = _BV(WAKEUPE);
        USBCON |= _BV(FRZCLK);
    }
    if (events & _BV(WAKEUPI)) {
        USBCON &= (uint8_t)~_BV(FRZCLK);
        UDINT = (uint8_t)~_BV(WAKEUPI);
        UDIEN = _BV(SUSPE);
    }
}

int main(void)
{
    UHWCON = _BV(UVREGE);
    USBCON = _BV(USBE) | _BV(FRZCLK);
    PLLCSR = _BV(PINDIV) | _BV(PLLE);
    while (!(PLLCSR & _BV(PLOCK))) { }
    USBCON = _BV(USBE) | _BV(OTGPADE);
    UDCON = DETACHED;
    UDIEN = SUSPENDS ? _BV(SUSPE) : 0;
    for (;;) {
        if (SUSPENDS)
            suspend_events();
        if (was_reset()) {
            UDINT = (uint8_t)~_BV(EORSTI);
            configured = held = 0;
            UENUM = 0;
            UECONX = _BV(EPEN);
            UECFG0X = 0;
            UECFG1X = 3 << 4 | _BV(ALLOC);
        }
        UENUM = 0;
        if (UEINTX & _BV(RXSTPI))
            control();
        if (configured) {
            echo();
            send_burst();
            take_sync();
        }
    }
}
