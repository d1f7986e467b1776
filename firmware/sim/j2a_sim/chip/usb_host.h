/* The host at the other end of the simulated USB cable: one full-speed port, its controller and its driver.
 *
 * In:  VBUS, reset, suspend, resume, transfers. Out: completed transfers, each with its cycle.
 * Rules: the bus has 12 Mbit/s by the host's clock, which frame_cycles sets: 12000 bit times a frame. A
 * transaction of n bytes takes (13 + n) * 8 bit times as in table 5-10 of USB 2.0, an IN without data 64, and
 * none begins that might not end before the next start of frame. The transfers of one endpoint follow one
 * another; endpoints take turns, transaction by transaction. What got NAK is tried again when its turn comes;
 * when all got NAK, the turns go on in theory only: they are counted, and at the first turn after something
 * changed on the chip, or after a start of frame, one is tried again. Three times no answer end a transfer.
 * A pull-up that is away for 2.5 us is a device that has gone, even if it comes back at once.
 */
#ifndef J2A_SIM_USB_HOST_H
#define J2A_SIM_USB_HOST_H

#include <stdint.h>

#include "usb_device.h"

enum { HOST_CONTROL, HOST_OUT, HOST_IN, HOST_BY_HAND }; /* by hand: one transaction, kind + its token */
enum { DONE_OK, DONE_STALL, DONE_NO_ANSWER, DONE_CANCELLED, DONE_OVERFLOW, DONE_NAK };
enum { HOST_OFF, HOST_IDLE, HOST_RESET, HOST_ACTIVE, HOST_SUSPENDED, HOST_RESUMING };
enum { USB_LOST = 0x10000 };
enum { PIPES = 33, BY_HAND = 32 }; /* pipes: 0 control, 1..15 OUT, 17..31 IN */

typedef struct usb_transfer {
    struct usb_transfer *next;
    int id, kind, endpoint, address; /* address: -1: the host's at that time */
    unsigned packet;
    uint8_t setup[8], *data;
    uint32_t length, done;
    int zero_packet, stage, errors, acknowledge, cancelled;
    int toggle;                      /* of control transfers and those by hand; -1: the host's */
    int status;
    uint64_t cycle, naks;
} usb_transfer_t;

typedef struct {
    avr_t *avr;
    usb_device_t *device;
    void (*on_complete)(void *param);
    void (*on_reset)(void *param);
    void *param;

    int state, address;
    unsigned frame;
    double frame_cycles, next_frame_cycles, frame_start, frame_end; /* cycles, by the host's clock */
    struct { double *starts; uint32_t *numbers; uint32_t count, next; } plan;
    uint64_t frame_due, step_due, signal_due, gap_due; /* 0: not waited for */
    uint8_t toggles[PIPES];
    usb_transfer_t *queue[PIPES], *completed, **completed_end;
    uint32_t completed_count;
    int next_id, turn;

    enum { WIRE_FREE, WIRE_TOKEN, WIRE_HANDSHAKE, WIRE_BARREN, WIRE_FULL } wire;
    double wire_free;                            /* when the next transaction may begin */
    int barren;                                  /* how many NAKs came one after the other */
    int touched;                                 /* something changed on the chip since the last token */
    struct {
        int pipe;
        usb_transfer_t *transfer;                /* NULL: cancelled meanwhile */
        usb_token_t token;
        unsigned length, toggle, packet;
        int acknowledge;
        usb_answer_t answer;
        double began, ends;
    } now;
    struct { uint64_t transactions, naks, sofs, bytes_in, bytes_out, wrong_toggles; } counters;
} usb_host_t;

void usb_host_attach(usb_host_t *, avr_t *, usb_device_t *);
void usb_host_free(usb_host_t *);

void usb_host_plug(usb_host_t *, int on);
int usb_host_attached(usb_host_t *);
void usb_host_set_counting(usb_host_t *, int counting); /* of the device */
void usb_host_set_suspend_flags(usb_host_t *, int reading); /* likewise */
int usb_host_lacks(const usb_host_t *); /* usb_device_lacks() */
int usb_host_state(const usb_host_t *);
/* Begins a bus reset of so many cycles. */
void usb_host_reset(usb_host_t *, uint64_t cycles);
void usb_host_suspend(usb_host_t *);
/* Begins 20 ms of resume signalling. */
void usb_host_resume(usb_host_t *);
unsigned usb_host_frame(const usb_host_t *);
double usb_host_frame_start(const usb_host_t *);
double usb_host_frame_cycles(const usb_host_t *);
void usb_host_set_frame_cycles(usb_host_t *, double);
/* Takes the place of what is planned: frames start at these cycles, which rise. Numbers are those of the frames, with
 * USB_LOST added if the device does not see the start. The first start may not be nearer than the frame that is
 * running; behind the last one frames go on as before. Returns 0, or -1: no memory. */
int usb_host_plan_frames(usb_host_t *, const double *starts, const uint32_t *numbers, uint32_t count);
int usb_host_address(const usb_host_t *);
void usb_host_set_address(usb_host_t *, int);
/* Endpoint address, with 0x80 for IN; -1: all. */
void usb_host_clear_toggle(usb_host_t *, int endpoint);

/* Returns the transfer's number, or -1: no memory. `data`: what goes out. `options`: zero_packet of OUT; for
 * one by hand its toggle, 255: the host's, + 256 * whether an IN is acknowledged. */
int usb_host_submit(usb_host_t *, int kind, int endpoint, int address, unsigned packet, const uint8_t *setup,
                    const uint8_t *data, uint32_t length, int options);
/* Ends it at once, or with its transaction that is on the wire. */
void usb_host_cancel(usb_host_t *, int id);
uint32_t usb_host_pending(const usb_host_t *);
uint32_t usb_host_completed(const usb_host_t *);
/* The oldest completion: id, status, transferred, cycle, naks. Then takes it, with `transferred` bytes of
 * data; returns whether they came in. */
void usb_host_look(const usb_host_t *, uint64_t *to);
int usb_host_take(usb_host_t *, uint8_t *data);
/* Copies the counters in the order of _build.USB_COUNTERS. */
void usb_host_counters(const usb_host_t *, uint64_t *to);

#endif
