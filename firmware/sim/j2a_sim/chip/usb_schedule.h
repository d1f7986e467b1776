/* The turns of the transactions on the wire; see usb_host.h for their rules.
 *
 * In:  the transfers in the host's queues, and what the device answers. Out: completed transfers.
 */
#ifndef J2A_SIM_USB_SCHEDULE_H
#define J2A_SIM_USB_SCHEDULE_H

#include "usb_host.h"

/* Cycles of so many bit times. */
double usb_bits(const usb_host_t *, double n);
/* A timer for a time that need not be whole; `due` keeps it, for a reset of the chip drops all timers. */
void usb_at(usb_host_t *, uint64_t *due, double cycle, avr_cycle_timer_t);
void usb_not_at(usb_host_t *, uint64_t *due, avr_cycle_timer_t);
/* Plans the next transaction, at wire_free or at once. */
void usb_plan(usb_host_t *);
/* Counts the turns since all got NAK, up to a cycle: all that could have been over by then got NAK. */
void usb_catch_up(usb_host_t *, double cycle);
/* Goes on after waiting: something changed on the chip, or in the queues. */
void usb_wake(usb_host_t *);
void usb_complete(usb_host_t *, int pipe, usb_transfer_t *, int status);
avr_cycle_count_t usb_on_step(avr_t *, avr_cycle_count_t when, void *host);

#endif
