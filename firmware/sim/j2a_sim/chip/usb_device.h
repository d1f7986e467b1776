/* The USB device controller of ATmega16U4/32U4, and of AT90USB82/162 = ATmega8U2/16U2/32U2.
 *
 * In:  register accesses of the firmware; what the host does on the wire: VBUS, reset, resume, start of
 *      frame, tokens with their data, handshakes.
 * Out: what the controller answers to a token, its flags and interrupts, its pull-up on D+.
 * It takes the place of simavr's own model, which knows neither data toggles nor time on the wire, and has
 * the two banks of an endpoint wrong.
 *
 * Rules: endpoints, banks and the memory that they share are the chip's, with its limits. An interrupt is a
 * level. Without clock (USBCON.FRZCLK, or a PLL that does not make 48 MHz) the controller answers nobody, and
 * of its registers only those that the data sheet names can be used. Where the data sheet leaves something
 * open, the model does what is harder on the firmware; each such place says so. Isochronous endpoints are not
 * modelled: they never answer.
 */
#ifndef J2A_SIM_USB_DEVICE_H
#define J2A_SIM_USB_DEVICE_H

#include <stdint.h>

#include "sim_avr.h"
#include "avr_usb.h"

enum { USB_ENDPOINTS = 7, USB_DPRAM = 832, USB_PACKET_MAX = 1023 };
typedef enum { USB_NONE, USB_ACK, USB_NAK, USB_STALL } usb_answer_t;
/* Readings of UEBCX, see UsbBus.counting. */
enum { USB_COUNTS_BANK, USB_COUNTS_BANKS, USB_COUNTS_SETUP_AS_0, USB_COUNTS_SETUP_AS_8 };
/* Readings of SUSPI and WAKEUPI, see UsbBus.suspend_flags. */
enum { USB_FLAGS_EXCLUSIVE, USB_FLAGS_INDEPENDENT };
typedef enum { USB_OUT, USB_IN, USB_SETUP } usb_token_t;

/* Bits of the endpoint registers. */
enum { UEINTX_TXINI = 1, UEINTX_STALLEDI = 2, UEINTX_RXOUTI = 4, UEINTX_KILLBK = 4, UEINTX_RXSTPI = 8,
       UEINTX_NAKOUTI = 0x10, UEINTX_RWAL = 0x20, UEINTX_NAKINI = 0x40, UEINTX_FIFOCON = 0x80 };
enum { UECONX_EPEN = 1, UECONX_RSTDT = 8, UECONX_STALLRQC = 0x10, UECONX_STALLRQ = 0x20 };
enum { UECFG0X_IN = 1, UECFG1X_ALLOC = 2, UESTA0X_UNDERFI = 0x20, UESTA0X_OVERFI = 0x40 };
enum { USB_CONTROL, USB_ISOCHRONOUS, USB_BULK, USB_INTERRUPT };

typedef struct {
    uint8_t enabled, stall, held;       /* UECONX.EPEN and STALLRQ; held: its bit of UERST is set */
    uint8_t cfg0, cfg1, ien, errors;    /* errors: OVERFI and UNDERFI */
    uint8_t flags;                      /* of UEINTX, without RWAL, which follows from the rest */
    uint8_t cfg_ok, banks;
    uint16_t start, size;               /* its place in the DPRAM, and bytes of one bank */
    uint16_t reserved;                  /* bytes from `start`; 0: no memory */
    uint16_t count[2];                  /* bytes in each bank */
    uint16_t at;                        /* what the CPU has read or written of its bank */
    uint8_t busy, cpu_bank, bus_bank;
    uint8_t toggle, expected;           /* of the next packet that goes out, that comes in */
    uint8_t seen_toggle;                /* of the last packet that came in */
    uint8_t unacknowledged;             /* a packet went out and no ACK came back: it goes out again */
    /* A control endpoint has one bank for both directions. */
    enum { BANK_FREE, BANK_SETUP, BANK_OUT, BANK_IN } bank;
    uint8_t read_request, status_begun; /* CTRLDIR; an OUT has told that the data stage is over */
} usb_endpoint_t;

typedef struct {
    usb_endpoint_t *endpoint;           /* NULL: the device does not take part */
    usb_token_t token;
    usb_answer_t answer;
    uint8_t toggle, repeated;
    uint16_t length;
    uint8_t data[USB_PACKET_MAX + 1];
} usb_flight_t;

typedef struct {
    avr_t *avr;
    avr_int_vector_t *gen, *com;
    int is_u2;                          /* else a U4 */
    void (*on_change)(void *param);     /* the answer to some token may be another one now */
    void (*on_reset)(void *param);      /* the chip was reset, and all timers of simavr are gone */
    void (*on_wakeup)(void *param);     /* the firmware signals remote wake-up */
    void *param;

    uint8_t uhwcon, usbcon, usbint, udcon, udint, udien, udaddr, uenum, uerst, pllcsr;
    uint16_t frame;
    usb_endpoint_t endpoints[USB_ENDPOINTS];
    uint8_t dpram[USB_DPRAM];
    int vbus, was_vbus, was_awake, suspended;
    int signalled;                      /* a reset or a resume is on the lines: they are not idle */
    int counting;                       /* USB_COUNTS_... */
    int suspend_flags;                  /* USB_FLAGS_... */
    int keep;                           /* the next reset is one of the CPU alone */
    uint64_t idle_since, pll_at, idle_at; /* cycles; the last two: 0 when not waited for */
    avr_run_t run;
    usb_flight_t flight;
    uint64_t fifo_errors;               /* accesses to UEDATX when there was nothing to read or no room */
    uint64_t repeated;                  /* packets that came with the toggle of the one before */
} usb_device_t;

static inline int usb_endpoint_count(const usb_device_t *u) { return u->is_u2 ? 5 : USB_ENDPOINTS; }

/* Takes over simavr's USB port. */
void usb_device_attach(usb_device_t *, avr_t *, avr_usb_t *port);

/* ---- what the host does ---- */
void usb_device_vbus(usb_device_t *, int on);
int usb_device_pulls_up(const usb_device_t *);
int usb_device_lacks(const usb_device_t *); /* why it pulls nothing up; 0: it does */
void usb_device_bus_reset(usb_device_t *, int end); /* called at its start with 0, at its end with 1 */
void usb_device_resume(usb_device_t *, int end);    /* likewise */
void usb_device_sof(usb_device_t *, unsigned frame);
/* A token, and the data of OUT and SETUP. For IN, `flight` then holds what the device sends. */
usb_answer_t usb_device_token(usb_device_t *, usb_token_t, unsigned address, unsigned endpoint, int toggle,
                              const uint8_t *data, unsigned length);
/* The end of that transaction; acknowledged: the host's ACK of an IN. Returns what the device answered. */
usb_answer_t usb_device_handshake(usb_device_t *, int acknowledged);

/* ---- usb_lines.c: clock, pull-up, interrupts, suspend ---- */
int usb_clocked(const usb_device_t *);
int usb_vbus_seen(const usb_device_t *);
uint8_t usb_endpoint_interrupts(const usb_device_t *); /* UEINT */
/* After a change of flags or enable bits. */
void usb_levels(usb_device_t *);
/* After anything else that the firmware changes. */
void usb_changed(usb_device_t *);
void usb_raise(usb_device_t *, uint8_t event); /* a bit of UDINT */
void usb_traffic(usb_device_t *);   /* something other than the idle state is on the lines */
void usb_on_running(struct avr_irq_t *, uint32_t running, void *device); /* of an interrupt's handler */
void usb_start_pll(usb_device_t *); /* if PLLE is set */
void usb_rearm(usb_device_t *);     /* the timers, after the chip's reset dropped them */
void usb_stop(usb_device_t *);      /* the timers */

#endif
