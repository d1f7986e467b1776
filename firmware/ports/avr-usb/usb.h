/* The USB device driver of this port: the controller of an ATmega8U2 to 32U4 or AT90USB162. In: the requests
 * of the host at endpoint 0, and what the bus does. Out: answers by chapter 9 of the USB 2.0 specification,
 * endpoints as configured, and what the main loop must know of the link (usb_trouble).
 * usb_device.c is the controller and the bus, usb_control.c are control transfers, usb_requests.c is what they ask
 * for, usb_descriptors.c is what the board says of itself, usb_endpoints.c are the endpoints that port.c moves the
 * bytes through, sync_usb.h is that of SyncUSB, usb_frames.c are the starts of frames.
 * Rules: endpoint 0 belongs to the interrupts, so that enumeration works while the application computes.
 * All other endpoints belong to the main context, which has interrupts off from the look at usb_trouble
 * and the choice in UENUM to the last access, so no interrupt need keep UENUM. Nothing waits for the host
 * in an interrupt. */
#ifndef USB_H
#define USB_H

#include <avr/io.h>
#include <stdbool.h>
#include <stdint.h>

#include "j2a_port_config.h"

#if !(defined PINDIV || (defined PLLP0 && defined REGDIS))
#error "MCU: not a chip of the families ATmega8U2, 16U2, 32U2, AT90USB82, 162, ATmega16U4 and 32U4"
#endif

/* Largest packet of endpoint 0, see USB_SIZE_16. So small that an interrupt is short; an ATmega32U2 has
 * 176 bytes of memory for endpoints, which would do for 32. */
#define USB_PACKET0 16

/* For UECFG0X and UECFG1X. */
enum {
    USB_CONTROL = 0,
    USB_BULK_OUT = 2 << EPTYPE0,
    USB_BULK_IN = 2 << EPTYPE0 | 1 << EPDIR,
    USB_INTERRUPT_OUT = 3 << EPTYPE0,
    USB_SIZE_16 = 1 << EPSIZE0 | 1 << ALLOC,
    USB_SIZE_64 = 3 << EPSIZE0 | 1 << ALLOC,
    USB_TWO_BANKS = 1 << EPBK0
};

/* What UEINTX is set to when the main context is done with a bank: a full one of an IN endpoint goes to
 * the host, an empty one of an OUT endpoint takes the next packet. Flags that are written as 1 stay as
 * they are. */
#define USB_SEND ((uint8_t)~(_BV(FIFOCON) | _BV(NAKINI) | _BV(RXOUTI) | _BV(TXINI)))
#define USB_RELEASE ((uint8_t)~(_BV(FIFOCON) | _BV(NAKOUTI) | _BV(RXOUTI)))

/* Chooses an endpoint. Returns UEINTX. */
static inline uint8_t usb_flags_of(uint8_t endpoint) {
    UENUM = endpoint;
    return UEINTX;
}

/* ------------------------------------------------------------------ usb_device.c ------------- */

/* usb_trouble, which j2a_port_config.h declares: 0 while packets flow. The port clears USB_RESTARTED and may use
 * USB_PORT for itself; interrupts off for that. */
enum {
    USB_UNCONFIGURED = 1, /* the host has not chosen the configuration, or the cable is out */
    USB_SUSPENDED = 2,    /* the bus is still; the controller has no clock, so keep off its registers */
    USB_RESTARTED = 4,    /* the endpoints were set up anew: what was in them is gone */
    USB_PORT = 8
};

/* Starts the controller and joins the bus; interrupts must be switched on afterwards. Called once. */
void usb_start(void);

/* Does what the interrupt USB_GEN does, for who waits with interrupts off. Called with interrupts off; UENUM is
 * any afterwards. */
void usb_events(void);

/* While the bus is suspended: sleeps until it wakes up, or until another interrupt. Returns at once where
 * interrupts are off. */
void usb_sleep(void);

/* ------------------------------------------------------------------ usb_frames.c ------------- */

#if J2A_PORT_FRAMES
/* Notes a start of frame; called with interrupts off. */
void usb_frame_started(void);

/* Returns the answer to the request of SyncUSB, in RAM; called with interrupts off. value, value_high: of wValue. */
const uint8_t *usb_frame_answer(uint8_t value, uint8_t value_high);
#endif

/* ------------------------------------------------------------------ usb_descriptors.c -------- */

enum { USB_INTERFACES = 1 + J2A_WITH_SYNCUSB, USB_ENDPOINTS = 2 + J2A_WITH_SYNCUSB };

/* Looks a descriptor up. Returns its length, 1..254, or 0 when there is none. *at is its address in flash, or
 * NULL when usb_descriptor_byte() has to be asked for each byte.
 * type, number: the two bytes of wValue. index: wIndex. */
uint8_t usb_descriptor(uint8_t type, uint8_t number, uint16_t index, const uint8_t **at);

/* A byte of the descriptor whose address was NULL. Not while usb_descriptor_waits(). */
uint8_t usb_descriptor_byte(uint8_t index);

/* Does the chip's memory keep that descriptor back? For some milliseconds at most. */
static inline bool usb_descriptor_waits(void) {
    return EECR & _BV(EEPE); /* it has one charge pump, and reads no signature row while it writes EEPROM */
}

/* ------------------------------------------------------------------ usb_endpoints.c ---------- */

/* Endpoints as the main context chooses them. */
enum { USB_TX = 1, USB_RX = 2, USB_SYNC = 3 };

/* Of endpoint 1 and up, in flash. */
typedef struct {
    uint8_t address;      /* as in its descriptor */
    uint8_t uecfg0x, uecfg1x;
    uint8_t interface;
} usb_endpoint;
extern const usb_endpoint usb_endpoints[USB_ENDPOINTS];

/* Sets the endpoints up, or takes them away. Called with interrupts off; UENUM is any afterwards. */
void usb_configure(bool on);

/* ------------------------------------------------------------------ usb_control.c ------------ */

/* Sets endpoint 0 up, and its requests to how they are after a bus reset. */
void usb_control_reset(void);

/* The address that the host has given, with ADDEN, until it knows that it is taken; else 0. */
extern uint8_t usb_new_address;

/* ------------------------------------------------------------------ usb_requests.c ----------- */

/* A SETUP packet; none of the fields of 16 bits is aligned, and most need only their lower half. */
typedef struct {
    uint8_t type, request, value, value_high, index, index_high, length, length_high;
} usb_setup;

/* Does what a request asks for. Returns how many bytes are to be sent, 0 where the request is all there
 * is, or USB_STALL; *source is where they are, as usb_descriptor() gives it. UENUM is any afterwards. */
uint8_t usb_answer(const usb_setup *setup, const uint8_t **source);

/* Where they are instead if they are in RAM, else NULL. */
#if J2A_PORT_FRAMES
extern const uint8_t *usb_in_ram;
#endif
enum { USB_STALL = 0xFF };

#endif
