/* See usb_host.h: the port, and the turns of the transactions on the wire. */
#include "usb_host.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "sim_cycle_timers.h"

/* Bit times: a frame; SYNC, PID, frame number and CRC of a start of frame with its end; until the first
 * transaction; a token and the turn-around after it; what a transaction takes beside its data; an IN or
 * anything that gets no data. */
enum { FRAME_BITS = 12000, SOF_BITS = 35, FIRST_BITS = 40, TOKEN_BITS = 36, OVERHEAD_BYTES = 13, SHORT_BITS = 64 };
static const double RESUME_S = 0.020;

static double bits(const usb_host_t *h, double n) { return n * h->frame_cycles / FRAME_BITS; }
static double whole(const usb_host_t *h, unsigned bytes) { return bits(h, (OVERHEAD_BYTES + bytes) * 8); }

static avr_cycle_count_t on_step(avr_t *avr, avr_cycle_count_t when, void *param);
static avr_cycle_count_t on_frame(avr_t *avr, avr_cycle_count_t when, void *param);
static avr_cycle_count_t on_signal(avr_t *avr, avr_cycle_count_t when, void *param);

static void at(usb_host_t *h, uint64_t *due, double cycle, avr_cycle_timer_t timer)
{
    uint64_t now = h->avr->cycle, then = (uint64_t)ceil(cycle);
    *due = then > now ? then : now + 1;
    avr_cycle_timer_register(h->avr, *due - now, timer, h);
}

static void not_at(usb_host_t *h, uint64_t *due, avr_cycle_timer_t timer)
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
        return reads ? (transaction_t){USB_IN, t->packet, NULL} : (transaction_t){USB_OUT, part, t->data + t->done};
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
    return x.token == USB_IN ? bits(h, SHORT_BITS) : whole(h, x.length);
}

/* Plans the next transaction, at h->wire_free or at once. */
static void plan(usb_host_t *h)
{
    int pipe = next_pipe(h, h->turn);
    not_at(h, &h->step_due, on_step);
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
    at(h, &h->step_due, h->wire_free + bits(h, TOKEN_BITS), on_step);
}

static void count_nak(usb_host_t *h, usb_transfer_t *t, uint64_t n)
{
    t->naks += n;
    h->counters.naks += n;
    h->counters.transactions += n;
}

/* The turns since all got NAK, up to a cycle: all that could have been over by then would have got NAK. */
static void catch_up(usb_host_t *h, double cycle)
{
    double round = 0, most = 0, token = bits(h, TOKEN_BITS);
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

static void wake(usb_host_t *h)
{
    if (h->wire != WIRE_BARREN && h->wire != WIRE_FREE)
        return;
    if (h->wire == WIRE_BARREN)
        catch_up(h, h->avr->cycle);
    h->barren = 0;
    h->wire_free = fmax(h->wire_free, h->wire == WIRE_FREE ? h->avr->cycle : 0);
    plan(h);
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

static void complete(usb_host_t *h, int pipe, usb_transfer_t *t, int status)
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

static void fail_all(usb_host_t *h)
{
    for (int p = 0; p < PIPES; p++)
        while (h->queue[p])
            complete(h, p, h->queue[p], DONE_NO_ANSWER);
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
        complete(h, pipe, t, DONE_OVERFLOW);
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
            complete(h, pipe, t, DONE_OK);
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
        complete(h, pipe, t, DONE_OK);
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
        complete(h, pipe, t, DONE_OK);
    }
}

static void missing(usb_host_t *h, usb_transfer_t *t, int pipe)
{
    if (t->kind >= HOST_BY_HAND || ++t->errors == 3)
        complete(h, pipe, t, DONE_NO_ANSWER);
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
            complete(h, pipe, t, DONE_NAK);
        break;
    case USB_STALL:
        complete(h, pipe, t, DONE_STALL);
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
        took = h->now.answer == USB_ACK ? whole(h, h->device->flight.length) : bits(h, SHORT_BITS);
    h->now.ends = h->now.began + took;
    h->wire = WIRE_HANDSHAKE;
    at(h, &h->step_due, h->now.ends, on_step);
}

static avr_cycle_count_t on_step(avr_t *avr, avr_cycle_count_t when, void *param)
{
    usb_host_t *h = param;
    (void)avr;
    (void)when;
    h->step_due = 0;
    if (h->wire == WIRE_TOKEN) {
        if (h->now.transfer)
            begin_transaction(h);
        else
            plan(h); /* cancelled before its token was out */
        return 0;
    }
    end_transaction(h);
    h->wire_free = h->now.ends;
    int pending = 0;
    for (int p = 0; p < PIPES; p++)
        pending += h->queue[p] != NULL;
    if (h->touched || !h->now.transfer) /* the others were not tried since */
        h->barren = 0;
    if (pending && h->barren >= pending)
        h->wire = WIRE_BARREN;
    else
        plan(h);
    return 0;
}

/* ---- the port ---- */

static void stop_frames(usb_host_t *h)
{
    not_at(h, &h->frame_due, on_frame);
    not_at(h, &h->step_due, on_step);
    h->wire = WIRE_FREE;
    h->now.transfer = NULL;
    h->barren = 0;
}

static void start_frames(usb_host_t *h)
{
    h->state = HOST_ACTIVE;
    h->frame_end = h->avr->cycle;
    at(h, &h->frame_due, h->frame_end + bits(h, SOF_BITS), on_frame);
}

static void disconnect(usb_host_t *h, int state)
{
    stop_frames(h);
    not_at(h, &h->signal_due, on_signal);
    h->state = state;
    fail_all(h);
}

static avr_cycle_count_t on_frame(avr_t *avr, avr_cycle_count_t when, void *param)
{
    usb_host_t *h = param;
    (void)avr;
    (void)when;
    h->frame_due = 0;
    if (!usb_host_attached(h)) {
        disconnect(h, HOST_IDLE);
        return 0;
    }
    if (h->wire == WIRE_BARREN)
        catch_up(h, h->frame_end);
    h->frame = (h->frame + 1) & 2047;
    h->frame_start = h->frame_end;
    h->frame_cycles = h->next_frame_cycles;
    h->frame_end += h->frame_cycles;
    h->counters.sofs++;
    usb_device_sof(h->device, h->frame);
    at(h, &h->frame_due, h->frame_end + bits(h, SOF_BITS), on_frame);
    h->wire_free = h->frame_start + bits(h, FIRST_BITS);
    h->barren = 0;
    plan(h);
    return 0;
}

static avr_cycle_count_t on_signal(avr_t *avr, avr_cycle_count_t when, void *param)
{
    usb_host_t *h = param;
    (void)avr;
    (void)when;
    h->signal_due = 0;
    if (!usb_host_attached(h)) {
        disconnect(h, HOST_IDLE);
        return 0;
    }
    if (h->state == HOST_RESET)
        usb_device_bus_reset(h->device, 1);
    else
        usb_device_resume(h->device, 1);
    start_frames(h);
    return 0;
}

int usb_host_attached(const usb_host_t *h) { return h->state != HOST_OFF && usb_device_pulls_up(h->device); }
int usb_host_state(const usb_host_t *h) { return h->state; }

void usb_host_plug(usb_host_t *h, int on)
{
    if (on == (h->state != HOST_OFF))
        return;
    disconnect(h, on ? HOST_IDLE : HOST_OFF);
    usb_device_vbus(h->device, on);
}

void usb_host_reset(usb_host_t *h, uint64_t cycles)
{
    stop_frames(h);
    for (int p = 0; p < PIPES; p++)
        while (h->queue[p])
            complete(h, p, h->queue[p], DONE_CANCELLED);
    h->state = HOST_RESET;
    h->address = 0;
    memset(h->toggles, 0, sizeof h->toggles);
    usb_device_bus_reset(h->device, 0);
    at(h, &h->signal_due, h->avr->cycle + (double)cycles, on_signal);
}

void usb_host_suspend(usb_host_t *h)
{
    if (h->state != HOST_ACTIVE)
        return;
    stop_frames(h);
    h->state = HOST_SUSPENDED;
}

void usb_host_resume(usb_host_t *h)
{
    if (h->state != HOST_SUSPENDED)
        return;
    h->state = HOST_RESUMING;
    usb_device_resume(h->device, 0);
    at(h, &h->signal_due, h->avr->cycle + RESUME_S * h->avr->frequency, on_signal);
}

static void on_wakeup(void *param)
{
    usb_host_t *h = param;
    if (h->state != HOST_SUSPENDED)
        return;
    h->state = HOST_RESUMING;
    at(h, &h->signal_due, h->avr->cycle + RESUME_S * h->avr->frequency, on_signal);
}

/* ---- what the driver asks ---- */

unsigned usb_host_frame(const usb_host_t *h) { return h->frame; }
double usb_host_frame_start(const usb_host_t *h) { return h->frame_start; }
double usb_host_frame_cycles(const usb_host_t *h) { return h->next_frame_cycles; }
void usb_host_set_frame_cycles(usb_host_t *h, double cycles) { h->next_frame_cycles = cycles; }
int usb_host_address(const usb_host_t *h) { return h->address; }
void usb_host_set_address(usb_host_t *h, int address) { h->address = address; }

void usb_host_clear_toggle(usb_host_t *h, int endpoint)
{
    if (endpoint < 0)
        memset(h->toggles, 0, sizeof h->toggles);
    else
        h->toggles[(endpoint & 15) + (endpoint & 0x80 ? 16 : 0)] = 0;
}

int usb_host_submit(usb_host_t *h, int kind, int endpoint, int address, unsigned packet, const uint8_t *setup,
                    const uint8_t *data, uint32_t length, int options)
{
    usb_transfer_t *t = calloc(1, sizeof *t);
    uint8_t *copy = malloc(length + USB_PACKET_MAX + 1);
    if (!t || !copy) {
        free(t);
        free(copy);
        return -1;
    }
    if (data)
        memcpy(copy, data, length);
    int in = kind == HOST_IN || kind == HOST_BY_HAND + USB_IN;
    int pipe = kind >= HOST_BY_HAND ? BY_HAND : endpoint + (in ? 16 : 0);
    *t = (usb_transfer_t){.id = ++h->next_id, .kind = kind, .endpoint = endpoint, .address = address,
                          .packet = packet, .data = copy, .length = length, .acknowledge = 1,
                          .toggle = -1};
    if (kind >= HOST_BY_HAND) {
        t->toggle = (int8_t)(options & 255);
        t->acknowledge = options >> 8 & 1;
    } else {
        t->zero_packet = options;
    }
    if (setup)
        memcpy(t->setup, setup, sizeof t->setup);
    usb_transfer_t **link = &h->queue[pipe];
    while (*link)
        link = &(*link)->next;
    *link = t;
    if (h->state != HOST_ACTIVE && h->state != HOST_SUSPENDED && h->state != HOST_RESUMING)
        complete(h, pipe, t, DONE_NO_ANSWER);
    else
        wake(h);
    return h->next_id;
}

void usb_host_cancel(usb_host_t *h, int id)
{
    for (int p = 0; p < PIPES; p++)
        for (usb_transfer_t *t = h->queue[p]; t; t = t->next)
            if (t->id == id) {
                if (h->wire == WIRE_BARREN)
                    catch_up(h, h->avr->cycle);
                complete(h, p, t, DONE_CANCELLED);
                wake(h);
                return;
            }
}

uint32_t usb_host_pending(const usb_host_t *h)
{
    uint32_t n = 0;
    for (int p = 0; p < PIPES; p++)
        for (const usb_transfer_t *t = h->queue[p]; t; t = t->next)
            n++;
    return n;
}

uint32_t usb_host_completed(const usb_host_t *h) { return h->completed_count; }

void usb_host_look(const usb_host_t *h, uint64_t *to)
{
    const usb_transfer_t *t = h->completed;
    uint64_t all[] = {t->id, t->status, t->done, t->cycle, t->naks};
    memcpy(to, all, sizeof all);
}

int usb_host_take(usb_host_t *h, uint8_t *data)
{
    usb_transfer_t *t = h->completed;
    int came_in = t->kind == HOST_CONTROL ? t->setup[0] >> 7 : t->kind == HOST_IN || t->kind == HOST_BY_HAND + USB_IN;
    memcpy(data, t->data, t->done);
    h->completed = t->next;
    if (!h->completed)
        h->completed_end = &h->completed;
    h->completed_count--;
    free(t->data);
    free(t);
    return came_in;
}

void usb_host_counters(const usb_host_t *h, uint64_t *to)
{
    memcpy(to, &h->counters, sizeof h->counters);
    to[sizeof h->counters / sizeof *to] = h->device->fifo_errors;
}

/* ---- attaching ---- */

static void on_change(void *param)
{
    usb_host_t *h = param;
    h->touched = 1;
    if (h->wire == WIRE_BARREN)
        wake(h);
}

/* The host knows of no reset of the chip; simavr drops all timers. */
static void on_reset(void *param)
{
    usb_host_t *h = param;
    if (h->frame_due)
        at(h, &h->frame_due, h->frame_due, on_frame);
    if (h->step_due)
        at(h, &h->step_due, h->step_due, on_step);
    if (h->signal_due)
        at(h, &h->signal_due, h->signal_due, on_signal);
}

void usb_host_attach(usb_host_t *h, avr_t *avr, usb_device_t *device)
{
    h->avr = avr;
    h->device = device;
    h->frame_cycles = h->next_frame_cycles = avr->frequency / 1000.0;
    h->completed_end = &h->completed;
    device->on_change = on_change;
    device->on_reset = on_reset;
    device->on_wakeup = on_wakeup;
    device->param = h;
}

void usb_host_free(usb_host_t *h)
{
    for (int p = 0; p < PIPES; p++)
        while (h->queue[p])
            complete(h, p, h->queue[p], DONE_CANCELLED);
    while (h->completed) {
        uint8_t *data = h->completed->data;
        usb_transfer_t *next = h->completed->next;
        free(data);
        free(h->completed);
        h->completed = next;
    }
}
