/* See adc.h. Times are those of the ATmega328P data sheet, section 24.4. */
#include "adc.h"

#include <string.h>

#include "sim_cycle_timers.h"
#include "sim_interrupts.h"

enum { ADSC = 1 << 6, ADIF = 1 << 4, ADCSRA_ADATE = 1 << 5, ADCSRA_ADEN = 1 << 7 };
enum { STEPS = 1024 };

static uint8_t *adcsra(adc_t *a) { return &a->avr->data[a->port->r_adcsra]; }

static unsigned divider(adc_t *a)
{
    unsigned bits = *adcsra(a) & 7;
    return bits ? 1u << bits : 2;
}

static double reference(adc_t *a)
{
    unsigned index = avr_regbit_get_array(a->avr, a->port->ref, 3);
    switch (a->port->ref_values[index]) {
    case ADC_VREF_VCC:
    case ADC_VREF_AVCC:
        return a->avcc;
    case ADC_VREF_V110:
        return 1.1;
    case ADC_VREF_V256:
        return 2.56;
    default:
        return a->aref;
    }
}

static double input(adc_t *a)
{
    switch (a->channel_kind) {
    case ADC_MUX_SINGLE:
        return a->channel < ADC_CHANNELS ? a->volts[a->channel] : 0;
    case ADC_MUX_REF:
        return a->channel / 1000.0;
    default:
        return 0;
    }
}

/* Whether the end of a conversion begins another one: ADATE, and ADTS is 0. */
static int runs_freely(adc_t *a)
{
    if (!(*adcsra(a) & ADCSRA_ADATE))
        return 0;
    unsigned trigger = avr_regbit_get_array(a->avr, a->port->adts, 4);
    if (trigger)
        AVR_LOG(a->avr, LOG_WARNING, "ADC: of its triggers only free running is modelled; ADTS is %u\n", trigger);
    return !trigger;
}

static avr_cycle_count_t step(avr_t *avr, avr_cycle_count_t when, void *param);

static void start(adc_t *a)
{
    unsigned period = divider(a);
    uint64_t since = a->avr->cycle - a->enabled;
    uint64_t begin = a->avr->cycle + (period - since % period);
    avr_adc_mux_t mux = a->port->muxmode[avr_regbit_get_array(a->avr, a->port->mux, 6)];
    a->channel_kind = mux.kind;
    a->channel = mux.src;
    if (mux.kind != ADC_MUX_SINGLE && mux.kind != ADC_MUX_REF)
        AVR_LOG(a->avr, LOG_WARNING, "ADC: only single-ended channels are modelled; MUX is %u\n",
                avr_regbit_get_array(a->avr, a->port->mux, 6));
    a->reference = reference(a);
    a->sampled = 0;
    a->ready = begin + (a->first ? 25 : 13) * period;
    uint64_t sample = begin + (a->first ? 27 : 3) * period / 2;
    a->first = 0;
    avr_cycle_timer_register(a->avr, sample - a->avr->cycle, step, a);
}

static avr_cycle_count_t step(avr_t *avr, avr_cycle_count_t when, void *param)
{
    adc_t *a = param;
    (void)when;
    if (!a->sampled) {
        a->sampled = 1;
        a->sample = input(a);
        return a->ready;
    }
    double steps = a->reference > 0 ? a->sample * STEPS / a->reference : STEPS;
    unsigned value = steps <= 0 ? 0 : steps >= STEPS ? STEPS - 1 : (unsigned)steps;
    if (!a->locked)
        a->result = avr_regbit_get(avr, a->port->adlar) ? value << 6 : value;
    a->conversions++;
    *adcsra(a) &= ~ADSC;
    avr_raise_interrupt(avr, &a->port->adc); /* sets ADIF also where the interrupt is off */
    if (runs_freely(a)) {
        *adcsra(a) |= ADSC;
        start(a);
    }
    return 0;
}

static void adcsra_write(avr_t *avr, avr_io_addr_t addr, uint8_t v, void *param)
{
    adc_t *a = param;
    uint8_t before = avr->data[addr];
    uint8_t flag = before & ADIF & ~v; /* writing 1 clears it */
    if (before & v & ADIF)
        avr_clear_interrupt(avr, &a->port->adc);
    if (!(v & ADCSRA_ADEN)) {
        avr_cycle_timer_cancel(avr, step, a);
        avr->data[addr] = (v & ~(ADIF | ADSC)) | flag;
        return;
    }
    if (!(before & ADCSRA_ADEN)) {
        a->enabled = avr->cycle;
        a->first = 1;
    }
    avr->data[addr] = (v & ~(ADIF | ADSC)) | flag | ((before | v) & ADSC);
    if (flag && !a->port->adc.pending && avr_regbit_get(avr, a->port->adc.enable))
        avr_raise_interrupt(avr, &a->port->adc);
    if ((v & ~before) & ADCSRA_ADATE)
        runs_freely(a); /* for the line in the log */
    if ((v & ~before) & ADSC)
        start(a);
}

static uint8_t adcl_read(avr_t *avr, avr_io_addr_t addr, void *param)
{
    adc_t *a = param;
    a->locked = 1;
    return avr->data[addr] = a->result;
}

static uint8_t adch_read(avr_t *avr, avr_io_addr_t addr, void *param)
{
    adc_t *a = param;
    a->locked = 0;
    return avr->data[addr] = a->result >> 8;
}

static void reset(struct avr_io_t *io)
{
    adc_t *a = io->avr->io[AVR_DATA_TO_IO(((avr_adc_t *)io)->r_adcl)].r.param;
    avr_cycle_timer_cancel(a->avr, step, a);
    a->result = 0;
    a->locked = 0;
}

void adc_set_volts(adc_t *a, int channel, double volts) { a->volts[channel] = volts; }

void adc_attach(adc_t *a, avr_t *avr)
{
    a->avr = avr;
    a->avcc = a->aref = 5;
    for (avr_io_t *io = avr->io_port; io; io = io->next)
        if (io->kind && !strcmp(io->kind, "adc"))
            a->port = (avr_adc_t *)io;
    if (!a->port)
        return;
    /* simavr's own hooks must not run as well, so they are replaced and not added to. */
    avr->io[AVR_DATA_TO_IO(a->port->r_adcsra)].w.c = adcsra_write;
    avr->io[AVR_DATA_TO_IO(a->port->r_adcsra)].w.param = a;
    avr->io[AVR_DATA_TO_IO(a->port->r_adcl)].r.c = adcl_read;
    avr->io[AVR_DATA_TO_IO(a->port->r_adcl)].r.param = a;
    avr->io[AVR_DATA_TO_IO(a->port->r_adch)].r.c = adch_read;
    avr->io[AVR_DATA_TO_IO(a->port->r_adch)].r.param = a;
    a->port->io.reset = reset;
    reset(&a->port->io);
}
