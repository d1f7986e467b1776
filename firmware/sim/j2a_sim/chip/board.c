/* See board.h. */
#include "board.h"

#include <stdlib.h>
#include <string.h>

#include "growing_array.h"
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
    pin->edges = grow_array(pin->edges, pin->count, &pin->size, sizeof *pin->edges);
    pin->edges[pin->count++] = (edge_t){port->io->io.avr->cycle, level};
}

static uint8_t mask_of(const board_pin_t *pin) { return 1 << (pin - pin->port->pins); }

static int pulled_up(const board_pin_t *pin)
{
    const avr_ioport_t *io = pin->port->io;
    const uint8_t *data = io->io.avr->data;
    return (data[io->r_port] & ~data[io->r_ddr] & mask_of(pin)) != 0;
}

/* Tells simavr what is held from outside. Without this a write to PORT would make it forget an
 * input that is held low against its pull-up. */
static void hold(board_port_t *port)
{
    avr_ioport_external_t external = {.name = port->io->name, .mask = port->driven | port->charging,
                                      .value = port->levels};
    avr_ioctl(port->io->io.avr, AVR_IOCTL_IOPORT_SET_EXTERNAL(port->io->name), &external);
}

static avr_cycle_count_t on_risen(avr_t *avr, avr_cycle_count_t when, void *param)
{
    board_pin_t *pin = param;
    (void)avr;
    (void)when;
    pin->port->charging &= ~mask_of(pin);
    pin->rises_at = 0;
    hold(pin->port);
    avr_raise_irq(pin->port->io->io.irq + (pin - pin->port->pins), 1);
    return 0;
}

/* Begins or ends the rise of a pin, after its pull-up, or who drives it, may have changed. */
static void charge(board_pin_t *pin)
{
    avr_t *avr = pin->port->io->io.avr;
    int rising = (pin->port->charging & mask_of(pin)) && pulled_up(pin);
    if (rising == (pin->rises_at != 0))
        return;
    pin->rises_at = rising ? avr->cycle + pin->rise : 0;
    if (rising)
        avr_cycle_timer_register(avr, pin->rise, on_risen, pin);
    else
        avr_cycle_timer_cancel(avr, on_risen, pin);
}

/* The program has written PORT. */
static void on_port(struct avr_irq_t *irq, uint32_t value, void *param)
{
    board_port_t *port = param;
    (void)irq;
    port->io->io.avr->data[port->io->r_port] = value;
    for (int bit = 0; port->charging && bit < 8; bit++)
        charge(&port->pins[bit]);
}

static void drive(board_t *b, int number, int level)
{
    board_port_t *port = &b->ports[number / 8];
    board_pin_t *pin = &port->pins[number % 8];
    uint8_t mask = mask_of(pin);
    port->driven &= ~mask;
    port->levels &= ~mask;
    port->charging &= ~mask;
    if (level <= BOARD_RELEASE) {
        pin->rise = BOARD_RELEASE - level;
        if (pin->rise && !pin->level)
            port->charging |= mask;
        level = pin->level || (!pin->rise && pulled_up(pin));
    } else {
        port->driven |= mask;
        port->levels |= level ? mask : 0;
    }
    hold(port);
    charge(pin);
    avr_raise_irq(port->io->io.irq + number % 8, level);
}

/* ---- flags of pin change interrupts: simavr sets them, and neither clears them when the program
 * says so nor looks at them when it switches the interrupt on ---- */

static void flags_write(avr_t *avr, avr_io_addr_t address, uint8_t value, void *param)
{
    board_t *b = param;
    for (int i = 0; i < b->port_count; i++) {
        avr_int_vector_t *vector = &b->ports[i].io->pcint;
        if (vector->vector && vector->raised.reg == address && (value >> vector->raised.bit & 1)) {
            avr_clear_interrupt(avr, vector);
            avr_regbit_clear(avr, vector->raised);
        }
    }
}

static void enable_write(avr_t *avr, avr_io_addr_t address, uint8_t value, void *param)
{
    board_t *b = param;
    avr->data[address] = value;
    for (int i = 0; i < b->port_count; i++) {
        avr_int_vector_t *vector = &b->ports[i].io->pcint;
        if (vector->vector && vector->enable.reg == address && !vector->pending
            && avr_regbit_get(avr, vector->enable) && avr_regbit_get(avr, vector->raised))
            avr_raise_interrupt(avr, vector);
    }
}

static void attach_flags(board_t *b)
{
    const avr_int_vector_t *known = NULL;
    for (int i = 0; i < b->port_count; i++) {
        const avr_int_vector_t *vector = &b->ports[i].io->pcint;
        if (!vector->vector || !vector->raised.reg || (known && known->raised.reg == vector->raised.reg))
            continue;
        known = vector; /* all ports share these two registers */
        avr_register_io_write(b->avr, vector->raised.reg, flags_write, b);
        avr_register_io_write(b->avr, vector->enable.reg, enable_write, b);
    }
}

/* ---- what comes when ---- */

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
    b->events = grow_array(b->events, b->event_count, &b->event_size, sizeof *b->events);
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
        avr_irq_register_notify(io->irq + IOPORT_IRQ_REG_PORT, on_port, port);
        for (int bit = 0; bit < 8; bit++) {
            port->pins[bit].port = port;
            avr_irq_register_notify(io->irq + bit, on_level, port);
        }
    }
    attach_flags(b);
}

void board_reset(board_t *b)
{
    for (int i = 0; i < b->port_count; i++) {
        board_port_t *port = &b->ports[i];
        uint8_t left = 0; /* a reset makes inputs of all pins */
        for (int bit = 0; bit < 8; bit++)
            left |= port->pins[bit].level << bit;
        for (int bit = 0; bit < 8; bit++)
            port->pins[bit].rises_at = 0; /* no pull-up is on, and simavr drops all timers */
        b->avr->data[port->io->r_pin] = (left & ~port->driven) | port->levels;
    }
    arm(b);
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
