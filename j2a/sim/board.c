/* See board.h. */
#include "board.h"

#include <stdlib.h>
#include <string.h>

#include "grown.h"
#include "sim_cycle_timers.h"

enum { ADC_TARGETS = BOARD_PORTS * 8 };

/* simavr tells a pin's level by an IRQ, more than once for one edge, and with a flag when it comes from a
 * timer's output. */
static void on_level(struct avr_irq_t *irq, uint32_t value, void *param)
{
    board_port_t *port = param;
    board_pin_t *pin = &port->pins[irq->irq];
    uint8_t level = (value & 0xff) != 0;
    if (level == pin->level)
        return;
    pin->level = level;
    if (!pin->watched)
        return;
    pin->edges = grown(pin->edges, pin->count, &pin->size, sizeof *pin->edges);
    pin->edges[pin->count++] = (edge_t){port->io->io.avr->cycle, level};
}

static void drive(board_t *b, int pin, int level)
{
    board_port_t *port = &b->ports[pin / 8];
    uint8_t mask = 1 << pin % 8;
    port->driven &= ~mask;
    port->levels &= ~mask;
    if (level == BOARD_RELEASE) {
        uint8_t *data = b->avr->data;
        level = (data[port->io->r_port] & ~data[port->io->r_ddr] & mask) /* the pull-up */
            || board_level(b, pin);
    } else {
        port->driven |= mask;
        port->levels |= level ? mask : 0;
    }
    /* Without this a write to PORT would make simavr forget an input that is held low against its
     * pull-up. */
    avr_ioport_external_t external = {.name = port->io->name, .mask = port->driven,
                                      .value = port->levels};
    avr_ioctl(b->avr, AVR_IOCTL_IOPORT_SET_EXTERNAL(port->io->name), &external);
    avr_raise_irq(port->io->io.irq + pin % 8, level);
}

static avr_cycle_count_t due(avr_t *avr, avr_cycle_count_t when, void *param)
{
    board_t *b = param;
    (void)when;
    while (b->next < b->event_count && b->events[b->next].cycle <= avr->cycle) {
        board_event_t event = b->events[b->next++];
        if (event.target >= ADC_TARGETS)
            adc_set_volts(b->adc, event.target - ADC_TARGETS, event.value);
        else
            drive(b, event.target, (int)event.value);
    }
    return b->next < b->event_count ? b->events[b->next].cycle : 0;
}

static void arm(board_t *b)
{
    avr_cycle_timer_cancel(b->avr, due, b);
    if (b->next < b->event_count)
        avr_cycle_timer_register(b->avr, b->events[b->next].cycle - b->avr->cycle, due, b);
}

void board_schedule(board_t *b, uint64_t cycle, int target, double value)
{
    if (b->next == b->event_count)
        b->next = b->event_count = 0;
    b->events = grown(b->events, b->event_count, &b->event_size, sizeof *b->events);
    uint32_t at = b->event_count++;
    for (; at > b->next && b->events[at - 1].cycle > cycle; at--)
        b->events[at] = b->events[at - 1];
    b->events[at] = (board_event_t){cycle, target, value};
    due(b->avr, 0, b); /* what is for now */
    arm(b);
}

uint32_t board_waiting(const board_t *b) { return b->event_count - b->next; }

void board_attach(board_t *b, avr_t *avr, adc_t *adc)
{
    b->avr = avr;
    b->adc = adc;
    for (avr_io_t *io = avr->io_port; io && b->port_count < BOARD_PORTS; io = io->next) {
        if (!io->kind || strcmp(io->kind, "port"))
            continue;
        board_port_t *port = &b->ports[b->port_count++];
        port->io = (avr_ioport_t *)io;
        for (int bit = 0; bit < 8; bit++)
            avr_irq_register_notify(io->irq + bit, on_level, port);
    }
}

void board_reset(board_t *b)
{
    for (int i = 0; i < b->port_count; i++) {
        board_port_t *port = &b->ports[i];
        uint8_t left = 0; /* a reset makes inputs of all pins */
        for (int bit = 0; bit < 8; bit++)
            left |= port->pins[bit].level << bit;
        b->avr->data[port->io->r_pin] = (left & ~port->driven) | port->levels;
    }
    arm(b); /* simavr drops all timers */
}

void board_free(board_t *b)
{
    for (int i = 0; i < b->port_count; i++)
        for (int bit = 0; bit < 8; bit++)
            free(b->ports[i].pins[bit].edges);
    free(b->events);
}

int board_pin(const board_t *b, char port, int bit)
{
    for (int i = 0; i < b->port_count; i++)
        if (b->ports[i].io->name == port)
            return i * 8 + bit;
    return -1;
}

static board_pin_t *pin_at(const board_t *b, int pin)
{
    return (board_pin_t *)&b->ports[pin / 8].pins[pin % 8];
}

int board_level(const board_t *b, int pin) { return pin_at(b, pin)->level; }
void board_watch(board_t *b, int pin) { pin_at(b, pin)->watched = 1; }
uint32_t board_edge_count(const board_t *b, int pin) { return pin_at(b, pin)->count; }

void board_take_edges(board_t *b, int pin, uint64_t *cycles, uint8_t *levels)
{
    board_pin_t *p = pin_at(b, pin);
    for (uint32_t i = 0; i < p->count; i++) {
        cycles[i] = p->edges[i].cycle;
        levels[i] = p->edges[i].level;
    }
    p->count = 0;
}
