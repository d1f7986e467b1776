/* See interrupts.h. */
#include "interrupts.h"

/* The chip takes 4 cycles (5 with a 3-byte program counter) to enter a handler, which simavr leaves out, and as
 * many for RETI. */
static unsigned entry(const avr_t *avr) { return 2u + avr->address_size; }

static void on_running(struct avr_irq_t *irq, uint32_t entered, void *param)
{
    interrupt_t *i = param;
    avr_t *avr = i->avr;
    (void)irq;
    if (entered) {
        uint64_t late = avr->cycle - i->pending;
        if (late > i->latest)
            i->latest = late;
        i->count++;
        i->entered = avr->cycle;
        avr->cycle += entry(avr);
        avr->run_cycle_count = 0; /* the next event is nearer now: look after one instruction */
    } else if (i->entered) {
        uint64_t took = avr->cycle + entry(avr) - i->entered;
        i->entered = 0;
        i->total += took;
        if (took > i->longest)
            i->longest = took;
    }
}

static void on_pending(struct avr_irq_t *irq, uint32_t pending, void *param)
{
    interrupt_t *i = param;
    (void)irq;
    if (pending)
        i->pending = i->avr->cycle;
}

void interrupts_attach(interrupts_t *s, avr_t *avr)
{
    for (int n = 0; n < avr->interrupts.vector_count; n++) {
        avr_int_vector_t *vector = avr->interrupts.vector[n];
        interrupt_t *i = &s->of[vector->vector & (VECTORS - 1)];
        i->avr = avr;
        avr_irq_register_notify(vector->irq + AVR_INT_IRQ_PENDING, on_pending, i);
        avr_irq_register_notify(vector->irq + AVR_INT_IRQ_RUNNING, on_running, i);
    }
}

void interrupts_clear(interrupts_t *s)
{
    for (int n = 0; n < VECTORS; n++)
        s->of[n].count = s->of[n].longest = s->of[n].total = s->of[n].latest = 0;
}
