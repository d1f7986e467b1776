/* See twi.h. Registers and times are those of the SRF02's technical documentation. */
#include "twi.h"

#include <string.h>

enum { MEASURES_MS = 65, REVISION = 6, UNUSED = 0x80, SHORTEST_CM = 16 };
enum { REAL_CM = 0x51, REAL_US = 0x52, US_PER_CM = 58 };
/* Of TWSR, as the data sheet numbers them. */
enum { TWI_MTX_ADR_ACK = 0x18, TWI_MTX_ADR_NACK = 0x20, TWI_MTX_DATA_ACK = 0x28, TWI_MTX_DATA_NACK = 0x30 };

static int is_busy(twi_t *t, srf02_t *s)
{
    if (s->is_measuring && t->avr->cycle >= s->ready_at)
        s->is_measuring = 0;
    return s->is_measuring;
}

static uint8_t reading(const srf02_t *s)
{
    switch (s->reg) {
    case 0:
        return REVISION;
    case 2:
        return s->measured >> 8;
    case 3:
        return (uint8_t)s->measured;
    case 4:
        return SHORTEST_CM >> 8;
    case 5:
        return SHORTEST_CM;
    default:
        return UNUSED;
    }
}

static void command(twi_t *t, srf02_t *s, uint8_t byte)
{
    if (s->reg != 0 || (byte != REAL_CM && byte != REAL_US))
        return;
    s->measured = byte == REAL_CM ? s->cm : s->cm * US_PER_CM;
    s->is_measuring = 1;
    s->measurements++;
    s->ready_at = t->avr->cycle + (uint64_t)MEASURES_MS * t->avr->frequency / 1000;
}

static void answer(twi_t *t, uint8_t message, uint8_t address, uint8_t data)
{
    avr_raise_irq(t->port->io.irq + TWI_IRQ_INPUT, avr_twi_irq_msg(message, address, data));
}

static void on_output(struct avr_irq_t *irq, uint32_t value, void *param)
{
    twi_t *t = param;
    avr_twi_msg_irq_t message = {.u.v = value};
    uint8_t what = message.u.twi.msg, address = message.u.twi.addr, data = message.u.twi.data;
    srf02_t *s = &t->sensors[address >> 1];
    (void)irq;
    t->is_address = (what & TWI_COND_START) != 0;
    if (what & TWI_COND_STOP || s->kind == TWI_ABSENT || is_busy(t, s))
        return;
    if (what & TWI_COND_START) {
        s->has_reg = 0;
        answer(t, TWI_COND_ACK, address, 1);
    } else if (what & TWI_COND_WRITE && s->kind != TWI_DEAF) {
        answer(t, TWI_COND_ACK, address, 1);
        if (s->has_reg)
            command(t, s, data);
        else
            s->reg = data;
        s->has_reg = 1;
    } else if (what & TWI_COND_READ) {
        answer(t, TWI_COND_READ, address, s->kind == TWI_DEAF ? 0xff : reading(s));
        s->reg++;
    }
}

static void on_status(struct avr_irq_t *irq, uint32_t value, void *param)
{
    twi_t *t = param;
    (void)irq;
    (void)value;
    t->is_done = 1;
}

/* What simavr says of data, for the address that was written. */
static uint8_t of_address(uint8_t state)
{
    return state == TWI_MTX_DATA_ACK ? TWI_MTX_ADR_ACK : state == TWI_MTX_DATA_NACK ? TWI_MTX_ADR_NACK : state;
}

/* Wraps simavr's own, which tells of an address as of data, and lets TWINT stand until a step ends, so that who polls it
 * sees the step before. Nothing that begins on a bus that hangs ends: TWINT never comes. */
static void control_write(avr_t *avr, avr_io_addr_t reg, uint8_t value, void *param)
{
    twi_t *t = param;
    avr_regbit_t flag = t->port->twi.raised;
    uint8_t mask = flag.mask << flag.bit, begins = value & mask; /* writing 1 clears it */
    int is_on = value >> t->port->twen.bit & t->port->twen.mask;
    t->is_done = t->is_address = 0;
    if (t->stuck && is_on)
        avr->data[reg] = (value & ~mask) | (avr->data[reg] & mask);
    else
        t->write(avr, reg, value, t->param);
    if (t->is_address)
        t->port->next_twstate = of_address(t->port->next_twstate);
    if (begins && is_on && !t->is_done) {
        avr->data[reg] &= ~mask;
        avr_clear_interrupt(avr, &t->port->twi);
    }
}

void twi_attach(twi_t *t, avr_t *avr)
{
    t->avr = avr;
    for (avr_io_t *io = avr->io_port; io; io = io->next)
        if (io->kind && !strcmp(io->kind, "twi"))
            t->port = (avr_twi_t *)io;
    if (!t->port)
        return;
    t->write = avr->io[AVR_DATA_TO_IO(t->port->r_twcr)].w.c;
    t->param = avr->io[AVR_DATA_TO_IO(t->port->r_twcr)].w.param;
    avr->io[AVR_DATA_TO_IO(t->port->r_twcr)].w.c = control_write;
    avr->io[AVR_DATA_TO_IO(t->port->r_twcr)].w.param = t;
    avr_irq_register_notify(t->port->io.irq + TWI_IRQ_OUTPUT, on_output, t);
    avr_irq_register_notify(t->port->io.irq + TWI_IRQ_STATUS, on_status, t);
}
