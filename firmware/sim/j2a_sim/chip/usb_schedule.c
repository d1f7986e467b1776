/* See usb_schedule.h. */
#include "usb_schedule.h"

#include <math.h>
#include <string.h>

#include "sim_cycle_timers.h"

/* Bit times: a frame; a token and the turn-around after it; what a transaction takes beside its data; an IN
 * that gets no data. */
enum { FRAME_BITS = 12000, TOKEN_BITS = 36, OVERHEAD_BYTES = 13, SHORT_BITS = 64 };

double usb_bits(const usb_host_t *h, double n) { return n * h->frame_cycles / FRAME_BITS; }
static double whole(const usb_host_t *h, unsigned bytes) { return usb_bits(h, (OVERHEAD_BYTES + bytes) * 8); }

void usb_at(usb_host_t *h, uint64_t *due, double cycle, avr_cycle_timer_t timer)
{
    uint64_t now = h->avr->cycle, then = (uint64_t)ceil(cycle);
    *due = then > now ? then : now + 1;
    avr_cycle_timer_register(h->avr, *due - now, timer, h);
}

void usb_not_at(usb_host_t *h, uint64_t *due, avr_cycle_timer_t timer)
{
    *due = 0;
    avr_cycle_timer_cancel(h->avr, timer, h);
}

/* ---- turns ---- */

typedef struct {
    usb_token_t token;
    unsigned length;    /* of OUT and SETUP; of IN the most that may come */
    const uint8_t *data;
} transaction_t;

static transaction_t next_of(const usb_transfer_t *t)
{
    unsigned rest = t->length - t->done, part = rest < t->packet ? rest : t->packet;
    if (t->kind >= HOST_BY_HAND) {
        usb_token_t token = t->kind - HOST_BY_HAND;
        return (transaction_t){token, token == USB_IN ? t->packet : t->length, t->data};
    }
    if (t->kind != HOST_CONTROL)
        return t->kind == HOST_IN ? (transaction_t){USB_IN, t->packet, NULL}
                                  : (transaction_t){USB_OUT, part, t->data + t->done};
    int reads = t->setup[0] >> 7;
    if (t->stage == 0)
        return (transaction_t){USB_SETUP, 8, t->setup};
    if (t->stage == 1)
        return reads ? (transaction_t){USB_IN, t->packet, NULL}
                     : (transaction_t){USB_OUT, part, t->data + t->done};
    return reads && t->length ? (transaction_t){USB_OUT, 0, NULL} : (transaction_t){USB_IN, t->packet, NULL};
}

static int next_pipe(const usb_host_t *h, int turn)
{
    for (int i = 1; i <= PIPES; i++)
        if (h->queue[(turn + i) % PIPES])
            return (turn + i) % PIPES;
    return -1;
}

static double longest(const usb_host_t *h, int pipe) { return whole(h, next_of(h->queue[pipe]).length); }

static double refused(const usb_host_t *h, int pipe)
{
    transaction_t x = next_of(h->queue[pipe]);
    return x.token == USB_IN ? usb_bits(h, SHORT_BITS) : whole(h, x.length);
}

void usb_plan(usb_host_t *h)
{
    int pipe = next_pipe(h, h->turn);
    usb_not_at(h, &h->step_due, usb_on_step);
    h->wire = WIRE_FREE;
    if (h->state != HOST_ACTIVE || pipe < 0)
        return;
    if (h->wire_free + longest(h, pipe) > h->frame_end) {
        h->wire = WIRE_FULL;
        return;
    }
    h->turn = pipe;
    h->wire = WIRE_TOKEN;
    h->now.pipe = pipe;
    h->now.transfer = h->queue[pipe];
    h->now.began = h->wire_free;
    usb_at(h, &h->step_due, h->wire_free + usb_bits(h, TOKEN_BITS), usb_on_step);
}

static void count_nak(usb_host_t *h, usb_transfer_t *t, uint64_t n)
{
    t->naks += n;
    h->counters.naks += n;
    h->counters.transactions += n;
}

void usb_catch_up(usb_host_t *h, double cycle)
{
    double round = 0, most = 0, token = usb_bits(h, TOKEN_BITS);
    for (int p = 0; p < PIPES; p++)
        if (h->queue[p]) {
            round += refused(h, p);
            most = fmax(most, longest(h, p));
        }
    if (round <= 0)
        return;
    double rounds = floor((fmin(cycle - token, h->frame_end - most) - h->wire_free) / round);
    if (rounds > 0) {
        h->wire_free += rounds * round;
        for (int p = 0; p < PIPES; p++)
            if (h->queue[p])
                count_nak(h, h->queue[p], (uint64_t)rounds);
    }
    for (;;) {
        int p = next_pipe(h, h->turn);
        if (h->wire_free + longest(h, p) > h->frame_end || h->wire_free + token >= cycle)
            return;
        h->wire_free += refused(h, p);
        h->turn = p;
        count_nak(h, h->queue[p], 1);
    }
}

void usb_wake(usb_host_t *h)
{
    if (h->wire != WIRE_BARREN && h->wire != WIRE_FREE)
        return;
    if (h->wire == WIRE_BARREN)
        usb_catch_up(h, h->avr->cycle);
    h->barren = 0;
    h->wire_free = fmax(h->wire_free, h->wire == WIRE_FREE ? h->avr->cycle : 0);
    usb_plan(h);
}

/* ---- the life of a transfer ---- */

static void unlink_transfer(usb_host_t *h, int pipe, usb_transfer_t *t)
{
    usb_transfer_t **link = &h->queue[pipe];
    while (*link != t)
        link = &(*link)->next;
    *link = t->next;
    if (h->now.transfer == t)
        h->now.transfer = NULL;
}

void usb_complete(usb_host_t *h, int pipe, usb_transfer_t *t, int status)
{
    unlink_transfer(h, pipe, t);
    t->next = NULL;
    t->status = status;
    t->cycle = h->avr->cycle;
    *h->completed_end = t;
    h->completed_end = &t->next;
    h->completed_count++;
    h->on_complete(h->param);
}

static uint8_t *toggle_of(usb_host_t *h, int pipe, usb_transfer_t *t)
{
    if (t->kind < HOST_BY_HAND)
        return t->kind == HOST_CONTROL ? NULL : &h->toggles[pipe];
    return &h->toggles[t->endpoint + (t->kind - HOST_BY_HAND == USB_IN ? 16 : 0)];
}

static unsigned wanted_toggle(usb_host_t *h, int pipe, usb_transfer_t *t)
{
    if (t->kind == HOST_CONTROL)
        return t->stage ? t->toggle : 0;
    return t->toggle >= 0 ? (unsigned)t->toggle : *toggle_of(h, pipe, t);
}

static void advance_toggle(usb_host_t *h, int pipe, usb_transfer_t *t)
{
    if (t->kind == HOST_CONTROL)
        t->toggle ^= 1;
    else
        *toggle_of(h, pipe, t) = !h->now.toggle;
}

static void keep(usb_transfer_t *t, const uint8_t *data, unsigned length)
{
    memcpy(t->data + t->done, data, length);
    t->done += length;
}

/* What an IN brought; returns 0 when the host does not take it and sends no ACK. */
static int take_in(usb_host_t *h, usb_transfer_t *t, int pipe)
{
    const usb_flight_t *f = &h->device->flight;
    int status = t->kind == HOST_CONTROL && t->stage == 2;
    unsigned room = status ? 0 : t->kind >= HOST_BY_HAND ? t->packet : t->length - t->done;
    if (f->length > t->packet || (f->toggle == h->now.toggle && f->length > room)) {
        usb_complete(h, pipe, t, DONE_OVERFLOW);
        return 0;
    }
    if (t->kind >= HOST_BY_HAND) {
        h->now.length = f->length;
        keep(t, f->data, f->length);
        return t->acknowledge;
    }
    if (f->toggle == h->now.toggle)
        keep(t, f->data, f->length);
    h->now.length = f->length;
    return 1;
}

static void progress(usb_host_t *h, usb_transfer_t *t, int pipe)
{
    unsigned length = h->now.length;
    int in = h->now.token == USB_IN, over;
    t->errors = 0;
    if (in && h->device->flight.toggle != h->now.toggle) {
        h->counters.wrong_toggles++; /* taken for a repetition: acknowledged and dropped */
        if (t->kind >= HOST_BY_HAND)
            usb_complete(h, pipe, t, DONE_OK);
        return;
    }
    *(in ? &h->counters.bytes_in : &h->counters.bytes_out) += h->now.token == USB_SETUP ? 0 : length;
    if (t->kind >= HOST_BY_HAND) {
        if (h->now.token == USB_SETUP)
            h->toggles[t->endpoint] = h->toggles[t->endpoint + 16] = 1;
        else if (t->acknowledge)
            advance_toggle(h, pipe, t);
        if (!in)
            t->done = length;
        usb_complete(h, pipe, t, DONE_OK);
        return;
    }
    if (h->now.token == USB_SETUP) {
        t->toggle = 1;
        t->stage = t->length ? 1 : 2;
        return;
    }
    advance_toggle(h, pipe, t);
    if (!in)
        t->done += length;
    over = t->done >= t->length || (in && length < t->packet) || t->stage == 2;
    if (!in && over && t->zero_packet && length && length == t->packet)
        over = 0;
    if (!over)
        return;
    if (t->kind == HOST_CONTROL && t->stage == 1) {
        t->stage = 2;
        t->toggle = 1;
    } else {
        usb_complete(h, pipe, t, DONE_OK);
    }
}

static void missing(usb_host_t *h, usb_transfer_t *t, int pipe)
{
    if (t->kind >= HOST_BY_HAND || ++t->errors == 3)
        usb_complete(h, pipe, t, DONE_NO_ANSWER);
}

static void end_transaction(usb_host_t *h)
{
    usb_transfer_t *t = h->now.transfer;
    int pipe = h->now.pipe, acknowledged = 1;
    h->counters.transactions++;
    if (t && h->now.token == USB_IN && h->now.answer == USB_ACK)
        acknowledged = take_in(h, t, pipe);
    t = h->now.transfer;
    uint64_t repeated = h->device->repeated;
    usb_answer_t answer = usb_device_handshake(h->device, acknowledged);
    h->counters.wrong_toggles += h->device->repeated - repeated;
    h->barren = answer == USB_NAK ? h->barren + 1 : 0;
    h->counters.naks += answer == USB_NAK;
    if (!t)
        return;
    switch (answer) {
    case USB_ACK:
        progress(h, t, pipe);
        break;
    case USB_NAK:
        t->errors = 0;
        t->naks++;
        if (t->kind >= HOST_BY_HAND)
            usb_complete(h, pipe, t, DONE_NAK);
        break;
    case USB_STALL:
        usb_complete(h, pipe, t, DONE_STALL);
        break;
    case USB_NONE:
        missing(h, t, pipe);
    }
}

static void begin_transaction(usb_host_t *h)
{
    usb_transfer_t *t = h->now.transfer;
    transaction_t x = next_of(t);
    int address = t->address < 0 ? h->address : t->address;
    h->now.token = x.token;
    h->now.length = x.length;
    h->now.toggle = wanted_toggle(h, h->now.pipe, t);
    h->touched = 0;
    h->now.answer = usb_device_token(h->device, x.token, address, t->endpoint, h->now.toggle,
                                     x.token == USB_IN ? NULL : x.data, x.token == USB_IN ? 0 : x.length);
    double took = whole(h, x.length);
    if (x.token == USB_IN)
        took = h->now.answer == USB_ACK ? whole(h, h->device->flight.length) : usb_bits(h, SHORT_BITS);
    h->now.ends = h->now.began + took;
    h->wire = WIRE_HANDSHAKE;
    usb_at(h, &h->step_due, h->now.ends, usb_on_step);
}

avr_cycle_count_t usb_on_step(avr_t *avr, avr_cycle_count_t when, void *param)
{
    usb_host_t *h = param;
    (void)avr;
    (void)when;
    h->step_due = 0;
    if (h->wire == WIRE_TOKEN) {
        if (h->now.transfer)
            begin_transaction(h);
        else
            usb_plan(h); /* cancelled before its token was out */
        return 0;
    }
    end_transaction(h);
    h->wire_free = h->now.ends;
    if (h->now.transfer && h->now.transfer->cancelled)
        usb_complete(h, h->now.pipe, h->now.transfer, DONE_CANCELLED);
    int pending = 0;
    for (int p = 0; p < PIPES; p++)
        pending += h->queue[p] != NULL;
    if (h->touched || !h->now.transfer) /* the others were not tried since */
        h->barren = 0;
    if (pending && h->barren >= pending)
        h->wire = WIRE_BARREN;
    else
        usb_plan(h);
    return 0;
}
