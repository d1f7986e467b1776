/* The endpoints of the controller: their registers, for usb_device.c, and what both halves of their model,
 * registers and transactions, use. */
#ifndef J2A_SIM_USB_ENDPOINT_H
#define J2A_SIM_USB_ENDPOINT_H

#include "usb_device.h"

/* Registers of the selected endpoint; `reg` is the data address. */
uint8_t usb_endpoint_read(usb_device_t *, avr_io_addr_t reg);
void usb_endpoint_write(usb_device_t *, avr_io_addr_t reg, uint8_t value);
void usb_endpoint_hold(usb_device_t *, uint8_t uerst);
void usb_endpoints_bus_reset(usb_device_t *);

static inline int type(const usb_endpoint_t *e) { return e->cfg0 >> 6; }
static inline int is_in(const usb_endpoint_t *e) { return e->cfg0 & UECFG0X_IN; }
static inline int works(const usb_endpoint_t *e)
{
    return e->enabled && !e->held && e->cfg_ok && (e->cfg1 & UECFG1X_ALLOC);
}

static inline uint8_t *cell(usb_device_t *u, const usb_endpoint_t *e, int bank, unsigned at)
{
    static uint8_t nowhere;
    unsigned where = e->start + bank * e->size + at;
    return where < USB_DPRAM ? &u->dpram[where] : &nowhere;
}

/* Its bank is free for IN, or holds a packet of OUT. */
static inline void bank_to_cpu(usb_endpoint_t *e)
{
    e->flags |= UEINTX_FIFOCON | (is_in(e) ? UEINTX_TXINI : UEINTX_RXOUTI);
    e->at = 0;
}

static inline int next_bank(const usb_endpoint_t *e, int bank) { return e->banks == 2 ? !bank : bank; }

#endif
