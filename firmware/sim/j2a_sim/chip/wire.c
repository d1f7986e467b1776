/* See wire.h. */
#include "wire.h"

#include <math.h>
#include <string.h>

#include "sim_cycle_timers.h"

unsigned wire_char_bits(wire_format_t f) { return 1 + f.data + (f.parity >= 2) + f.stop; }

static int wire_level(const wire_t *w, double t)
{
    for (int i = 0; i < WIRE_RECENT; i++) {
        const wire_char_t *c = &w->recent[i];
        if (c->bits && t >= c->start && t < c->start + c->bits * c->bit)
            return (c->levels >> (unsigned)((t - c->start) / c->bit)) & 1;
    }
    return 1;
}

static avr_cycle_count_t wire_event(avr_t *avr, avr_cycle_count_t when, void *param);

/* The next falling edge from `from` on, or -1: only characters that have begun are known. */
static double next_edge(const wire_t *w, double from)
{
    for (int i = WIRE_RECENT - 1; i >= 0; i--) {
        const wire_char_t *c = &w->recent[i];
        for (unsigned bit = 0; bit < c->bits; bit++) {
            double t = c->start + bit * c->bit;
            if (t >= from && !((c->levels >> bit) & 1) && wire_level(w, t - 0.25))
                return t;
        }
    }
    return -1;
}

static void receive_from(wire_t *w, double start)
{
    double at = start;
    if (ceil(start) > w->avr->cycle) {
        w->state = WIRE_EDGE_AHEAD;
    } else {
        wire_format_t f = w->format(w->user);
        unsigned bits = 1 + f.data + (f.parity >= 2) + 1; /* a second stop bit is not looked at */
        if (w->edge)
            w->edge(w->user);
        w->bit = w->receiver_bit(w->user);
        w->state = WIRE_SAMPLING;
        at += (bits - 0.5) * w->bit;
    }
    w->start = start;
    double delay = ceil(at) - w->avr->cycle;
    avr_cycle_timer_register(w->avr, delay < 1 ? 1 : (avr_cycle_count_t)delay, wire_event, w);
}

static avr_cycle_count_t wire_event(avr_t *avr, avr_cycle_count_t when, void *param)
{
    wire_t *w = param;
    (void)avr;
    (void)when;
    if (w->state == WIRE_EDGE_AHEAD) {
        receive_from(w, w->start);
        return 0;
    }
    wire_format_t f = w->format(w->user);
    unsigned bit = 0, byte = 0, ones = 0, parity_error = 0;
#define SAMPLE() wire_level(w, w->start + (bit++ + 0.5) * w->bit)
    int false_start = SAMPLE();
    for (unsigned i = 0; i < f.data; i++) {
        unsigned one = SAMPLE();
        byte |= one << i;
        ones += one;
    }
    if (f.parity >= 2)
        parity_error = ((ones + SAMPLE()) & 1) != (f.parity & 1);
    double stop_at = w->start + (bit + 0.5) * w->bit;
    int framing_error = !SAMPLE();
#undef SAMPLE
    w->state = WIRE_IDLE;
    if (!false_start)
        w->deliver(w->user, byte, framing_error, parity_error);
    double edge = next_edge(w, stop_at);
    if (edge >= 0)
        receive_from(w, edge);
    return 0;
}

double wire_send(wire_t *w, double start, double bit, uint8_t byte)
{
    wire_format_t f = w->format(w->user);
    unsigned levels = 0, bits = 1, ones = 0;
    for (unsigned i = 0; i < f.data; i++, bits++) {
        unsigned one = i < 8 ? (byte >> i) & 1 : 0;
        levels |= one << bits;
        ones += one;
    }
    if (f.parity >= 2)
        levels |= ((ones + f.parity) & 1) << bits++;
    for (unsigned i = 0; i < f.stop; i++)
        levels |= 1u << bits++;
    memmove(&w->recent[1], &w->recent[0], sizeof w->recent - sizeof w->recent[0]);
    wire_char_t c = {start, bit, levels, bits};
    w->recent[0] = c;
    if (w->listens && w->state == WIRE_IDLE)
        receive_from(w, start);
    return start + bits * bit;
}

void wire_cut(wire_t *w)
{
    uint64_t now = w->avr->cycle;
    wire_char_t *last = &w->recent[0];
    unsigned sent = 0;
    while (sent < last->bits && last->start + sent * last->bit < now)
        sent++;
    last->levels |= ~0u << sent;
    if (w->state == WIRE_SAMPLING)
        wire_event(w->avr, now, w);
    w->state = WIRE_IDLE;
}

void wire_listen(wire_t *w, int on)
{
    if (on == w->listens)
        return;
    w->listens = on;
    w->state = WIRE_IDLE;
    avr_cycle_timer_cancel(w->avr, wire_event, w);
    double edge = on ? next_edge(w, w->avr->cycle) : -1;
    if (edge >= 0)
        receive_from(w, edge);
}
