/* See mcu.h. */
#include "mcu.h"

#include <string.h>

#include "avr_extint.h"
#include "avr_ioport.h"
#include "avr_timer.h"

enum { PORTC_OF_USB162 = 0x28 };

static const struct {
    const char *name, *relative;
    uint32_t flash_end;
    uint16_t ram_end, eeprom_end;
    uint8_t signature[3];
} relatives[] = {
    {"atmega16u4", "atmega32u4", 0x3fff, 0x5ff, 0x1ff, {0x1e, 0x94, 0x88}},
    {"at90usb82", "at90usb162", 0x1fff, 0x2ff, 0x1ff, {0x1e, 0x93, 0x82}},
    {"atmega8u2", "at90usb162", 0x1fff, 0x2ff, 0x1ff, {0x1e, 0x93, 0x89}},
    {"atmega16u2", "at90usb162", 0x3fff, 0x2ff, 0x1ff, {0x1e, 0x94, 0x89}},
    {"atmega32u2", "at90usb162", 0x7fff, 0x4ff, 0x3ff, {0x1e, 0x95, 0x8a}},
};

enum { RELATIVES = sizeof relatives / sizeof relatives[0] };

const char *mcu_relative(unsigned number) { return number < RELATIVES ? relatives[number].name : NULL; }

avr_t *mcu_make(const char *name)
{
    for (unsigned i = 0; i < RELATIVES; i++) {
        if (strcmp(relatives[i].name, name))
            continue;
        avr_t *avr = avr_make_mcu_by_name(relatives[i].relative);
        if (!avr)
            return NULL;
        avr->mmcu = relatives[i].name;
        avr->flashend = relatives[i].flash_end;
        avr->ramend = relatives[i].ram_end;
        avr->e2end = relatives[i].eeprom_end;
        memcpy(avr->signature, relatives[i].signature, sizeof avr->signature);
        return avr;
    }
    return avr_make_mcu_by_name(name);
}

int mcu_is_usb162(const avr_t *avr)
{
    const char *name = avr->mmcu;
    for (unsigned i = 0; i < RELATIVES; i++)
        if (!strcmp(name, relatives[i].name))
            name = relatives[i].relative;
    return !strcmp(name, "at90usb162");
}

static void on_output(struct avr_irq_t *irq, uint32_t value, void *param)
{
    mcu_output_t *o = param;
    avr_t *avr = o->timer->io.avr;
    int level = (value & 0xff) != 0;
    int pwm = o->timer->wgm_op_mode_kind >= avr_timer_wgm_pwm;
    (void)irq;
    switch (avr_regbit_get(avr, o->unit->com)) {
    case avr_timer_com_toggle:
        level = !avr_regbit_get(avr, o->port);
        break;
    case avr_timer_com_clear:
        if (level && !pwm)
            return;
        break;
    case avr_timer_com_set:
        if (!level && !pwm)
            return;
        break;
    }
    avr_raise_irq(o->pin, AVR_IOPORT_OUTPUT | level);
}

static void mend_output(mcu_t *m, avr_timer_t *timer, int index)
{
    avr_t *avr = timer->io.avr;
    avr_irq_t *output = timer->io.irq + TIMER_IRQ_OUT_COMP + index;
    avr_timer_comp_t *unit = &timer->comp[index];
    avr_ioport_getirq_t pin = {.bit = unit->com_pin};
    if (m->count == MCU_OUTPUTS || avr_ioctl(avr, AVR_IOCTL_IOPORT_GETIRQ_REGBIT, &pin) <= 0)
        return;
    avr_unconnect_irq(output, pin.irq[0]);
    unit->com_pin.reg = 0; /* or a reset would connect them again */
    output->flags &= ~IRQ_FLAG_FILTERED;
    mcu_output_t *o = &m->outputs[m->count++];
    *o = (mcu_output_t){timer, unit, pin.bit, pin.irq[0]};
    if (mcu_is_usb162(avr) && timer->name == '1' && index < 2) {
        /* simavr has them on PB1 and PB2; OC1A is PC6, OC1B is PC5 */
        int bit = 6 - index;
        avr_ioport_getirq_t c = {.bit = {.reg = PORTC_OF_USB162, .bit = bit, .mask = 1}};
        avr_ioctl(avr, AVR_IOCTL_IOPORT_GETIRQ_REGBIT, &c);
        o->port = c.bit;
        o->pin = c.irq[0];
    }
    avr_irq_register_notify(output, on_output, o);
}

/* EIMSK is written: simavr is to look at the pins whose interrupts are on. */
static void enable_write(avr_t *avr, avr_io_addr_t reg, uint8_t value, void *param)
{
    avr_extint_t *interrupts = param;
    avr_core_watch_write(avr, reg, value);
    for (int i = 0; i < EXTINT_COUNT; i++) {
        avr_int_vector_t *vector = &interrupts->eint[i].vector;
        if (vector->vector && vector->enable.reg == reg)
            interrupts->eint[i].strict_lvl_trig = avr_regbit_get(avr, vector->enable);
    }
}

/* While a pin is low that has a level interrupt, simavr looks at it in each cycle, which takes 17 times as long; also where
 * the interrupt is off, as in each program that uses such a pin for something else. */
static void mend_interrupts(avr_t *avr, avr_extint_t *interrupts)
{
    avr_io_addr_t last = 0;
    for (int i = 0; i < EXTINT_COUNT; i++) {
        avr_io_addr_t reg = interrupts->eint[i].vector.enable.reg;
        interrupts->eint[i].strict_lvl_trig = 0;
        if (interrupts->eint[i].vector.vector && reg != last)
            avr_register_io_write(avr, last = reg, enable_write, interrupts);
    }
}

void mcu_mend(mcu_t *m, avr_t *avr)
{
    for (avr_io_t *io = avr->io_port; io; io = io->next)
        if (io->kind && !strcmp(io->kind, "extint"))
            mend_interrupts(avr, (avr_extint_t *)io);
        else if (io->kind && !strcmp(io->kind, "timer"))
            for (int i = 0; i < AVR_TIMER_COMP_COUNT; i++)
                mend_output(m, (avr_timer_t *)io, i);
}
