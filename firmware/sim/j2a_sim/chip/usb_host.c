/* See usb_host.h: the port, and what the driver asks. */
#include "usb_host.h"

#include <stdlib.h>
#include <string.h>

#include "sim_cycle_timers.h"
#include "usb_schedule.h"

/* Bit times: a start of frame, and until the first transaction. */
enum { SOF_BITS = 35, FIRST_BITS = 40 };
static const double RESUME_S = 0.020;
static const double DISCONNECT_S = 2.5e-6; /* 7.1.7.3 of USB 2.0, TDDIS; a shorter gap may go unseen */

static avr_cycle_count_t on_frame(avr_t *avr, avr_cycle_count_t when, void *param);
static avr_cycle_count_t on_signal(avr_t *avr, avr_cycle_count_t when, void *param);
static avr_cycle_count_t on_gap(avr_t *avr, avr_cycle_count_t when, void *param);

/* ---- the port ---- */

static void fail_all(usb_host_t *h)
{
    for (int p = 0; p < PIPES; p++)
        while (h->queue[p])
            usb_complete(h, p, h->queue[p], DONE_NO_ANSWER);
}

static void stop_frames(usb_host_t *h)
{
    usb_not_at(h, &h->frame_due, on_frame);
    usb_not_at(h, &h->step_due, usb_on_step);
    h->wire = WIRE_FREE;
    h->now.transfer = NULL;
    h->barren = 0;
}

/* The end of the frame that starts at `start`: the next start that is planned. */
static double end_of_frame(usb_host_t *h, double start)
{
    while (h->plan.next < h->plan.count && h->plan.starts[h->plan.next] <= start)
        h->plan.next++;
    return h->plan.next < h->plan.count ? h->plan.starts[h->plan.next] : start + h->next_frame_cycles;
}

static void start_frames(usb_host_t *h)
{
    h->state = HOST_ACTIVE;
    h->frame_end = h->plan.next < h->plan.count ? end_of_frame(h, h->avr->cycle) : h->avr->cycle;
    usb_at(h, &h->frame_due, h->frame_end + usb_bits(h, SOF_BITS), on_frame);
}

static void disconnect(usb_host_t *h, int state)
{
    stop_frames(h);
    usb_not_at(h, &h->signal_due, on_signal);
    usb_not_at(h, &h->gap_due, on_gap);
    h->state = state;
    fail_all(h);
}

static avr_cycle_count_t on_gap(avr_t *avr, avr_cycle_count_t when, void *param)
{
    usb_host_t *h = param;
    (void)avr;
    (void)when;
    disconnect(h, HOST_IDLE);
    return 0;
}

/* Looks at the pull-up. */
static void follow_device(usb_host_t *h)
{
    if (usb_device_pulls_up(h->device))
        usb_not_at(h, &h->gap_due, on_gap);
    else if (h->state > HOST_IDLE && !h->gap_due)
        usb_at(h, &h->gap_due, h->avr->cycle + DISCONNECT_S * h->avr->frequency, on_gap);
}

static avr_cycle_count_t on_frame(avr_t *avr, avr_cycle_count_t when, void *param)
{
    usb_host_t *h = param;
    (void)avr;
    (void)when;
    h->frame_due = 0;
    follow_device(h);
    if (h->wire == WIRE_BARREN)
        usb_catch_up(h, h->frame_end);
    h->frame = (h->frame + 1) & 2047;
    int lost = 0;
    if (h->plan.next < h->plan.count) {
        h->frame = h->plan.numbers[h->plan.next] & 2047;
        lost = (h->plan.numbers[h->plan.next] & USB_LOST) != 0;
    }
    h->frame_start = h->frame_end;
    h->frame_end = end_of_frame(h, h->frame_start);
    h->frame_cycles = h->next_frame_cycles;
    h->counters.sofs++;
    if (!lost)
        usb_device_sof(h->device, h->frame);
    usb_at(h, &h->frame_due, h->frame_end + usb_bits(h, SOF_BITS), on_frame);
    h->wire_free = h->frame_start + usb_bits(h, FIRST_BITS);
    h->barren = 0;
    usb_plan(h);
    return 0;
}

static avr_cycle_count_t on_signal(avr_t *avr, avr_cycle_count_t when, void *param)
{
    usb_host_t *h = param;
    (void)avr;
    (void)when;
    h->signal_due = 0;
    follow_device(h);
    if (h->state == HOST_RESET)
        usb_device_bus_reset(h->device, 1);
    else
        usb_device_resume(h->device, 1);
    start_frames(h);
    return 0;
}

int usb_host_attached(usb_host_t *h)
{
    follow_device(h);
    return h->state != HOST_OFF && usb_device_pulls_up(h->device);
}

int usb_host_state(const usb_host_t *h) { return h->state; }
void usb_host_set_counting(usb_host_t *h, int counting) { h->device->counting = counting; }
void usb_host_set_suspend_flags(usb_host_t *h, int reading) { h->device->suspend_flags = reading; }
int usb_host_lacks(const usb_host_t *h) { return usb_device_lacks(h->device); }

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
            usb_complete(h, p, h->queue[p], DONE_CANCELLED);
    h->state = HOST_RESET;
    h->address = 0;
    memset(h->toggles, 0, sizeof h->toggles);
    usb_device_bus_reset(h->device, 0);
    usb_at(h, &h->signal_due, h->avr->cycle + (double)cycles, on_signal);
}

void usb_host_suspend(usb_host_t *h)
{
    if (h->state != HOST_ACTIVE)
        return;
    usb_transfer_t *cut = h->now.transfer;
    stop_frames(h);
    h->state = HOST_SUSPENDED;
    if (cut && cut->cancelled)
        usb_complete(h, h->now.pipe, cut, DONE_CANCELLED);
}

void usb_host_resume(usb_host_t *h)
{
    if (h->state != HOST_SUSPENDED)
        return;
    h->state = HOST_RESUMING;
    usb_device_resume(h->device, 0);
    usb_at(h, &h->signal_due, h->avr->cycle + RESUME_S * h->avr->frequency, on_signal);
}

static void on_wakeup(void *param)
{
    usb_host_t *h = param;
    if (h->state != HOST_SUSPENDED)
        return;
    h->state = HOST_RESUMING;
    usb_at(h, &h->signal_due, h->avr->cycle + RESUME_S * h->avr->frequency, on_signal);
}

/* ---- what the driver asks ---- */

unsigned usb_host_frame(const usb_host_t *h) { return h->frame; }
double usb_host_frame_start(const usb_host_t *h) { return h->frame_start; }
double usb_host_frame_cycles(const usb_host_t *h) { return h->next_frame_cycles; }
void usb_host_set_frame_cycles(usb_host_t *h, double cycles) { h->next_frame_cycles = cycles; }

int usb_host_plan_frames(usb_host_t *h, const double *starts, const uint32_t *numbers, uint32_t count)
{
    double *own_starts = malloc(count * sizeof *starts + 1);
    uint32_t *own_numbers = malloc(count * sizeof *numbers + 1);
    if (!own_starts || !own_numbers) {
        free(own_starts);
        free(own_numbers);
        return -1;
    }
    memcpy(own_starts, starts, count * sizeof *starts);
    memcpy(own_numbers, numbers, count * sizeof *numbers);
    free(h->plan.starts);
    free(h->plan.numbers);
    h->plan.starts = own_starts;
    h->plan.numbers = own_numbers;
    h->plan.count = count;
    h->plan.next = 0;
    if (h->state == HOST_ACTIVE) {
        h->frame_end = end_of_frame(h, h->frame_start);
        usb_not_at(h, &h->frame_due, on_frame);
        usb_at(h, &h->frame_due, h->frame_end + usb_bits(h, SOF_BITS), on_frame);
    }
    return 0;
}

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
        usb_complete(h, pipe, t, DONE_NO_ANSWER);
    else
        usb_wake(h);
    return h->next_id;
}

void usb_host_cancel(usb_host_t *h, int id)
{
    for (int p = 0; p < PIPES; p++)
        for (usb_transfer_t *t = h->queue[p]; t; t = t->next)
            if (t->id == id) {
                t->cancelled = 1;
                if (h->wire == WIRE_HANDSHAKE && h->now.transfer == t)
                    return; /* it ends with the transaction that is on the wire */
                if (h->wire == WIRE_BARREN)
                    usb_catch_up(h, h->avr->cycle);
                usb_complete(h, p, t, DONE_CANCELLED);
                usb_wake(h);
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
    int came_in = t->kind == HOST_IN || t->kind == HOST_BY_HAND + USB_IN;
    if (t->kind == HOST_CONTROL)
        came_in = t->setup[0] >> 7;
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
    follow_device(h);
    if (h->wire == WIRE_BARREN)
        usb_wake(h);
}

/* The host knows of no reset of the chip; simavr drops all timers. */
static void on_reset(void *param)
{
    usb_host_t *h = param;
    if (h->frame_due)
        usb_at(h, &h->frame_due, h->frame_due, on_frame);
    if (h->step_due)
        usb_at(h, &h->step_due, h->step_due, usb_on_step);
    if (h->signal_due)
        usb_at(h, &h->signal_due, h->signal_due, on_signal);
    if (h->gap_due)
        usb_at(h, &h->gap_due, h->gap_due, on_gap);
    follow_device(h);
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
    free(h->plan.starts);
    free(h->plan.numbers);
    for (int p = 0; p < PIPES; p++)
        while (h->queue[p])
            usb_complete(h, p, h->queue[p], DONE_CANCELLED);
    while (h->completed) {
        uint8_t *data = h->completed->data;
        usb_transfer_t *next = h->completed->next;
        free(data);
        free(h->completed);
        h->completed = next;
    }
}
