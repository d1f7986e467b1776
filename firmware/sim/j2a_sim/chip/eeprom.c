/* See eeprom.h. Times are those of the ATmega328P data sheet, section 8.4. */
#include "eeprom.h"

#include <string.h>

#include "sim_cycle_timers.h"
#include "sim_interrupts.h"

enum { WRITE_US = 3400, MASTER_CYCLES = 4 };

static avr_eeprom_t *find(const avr_t *avr)
{
    for (avr_io_t *io = avr->io_port; io; io = io->next)
        if (io->kind && !strcmp(io->kind, "eeprom"))
            return (avr_eeprom_t *)io;
    return NULL;
}

static avr_cycle_count_t master_over(avr_t *avr, avr_cycle_count_t when, void *param)
{
    (void)when;
    avr_regbit_clear(avr, ((avr_eeprom_t *)param)->eempe);
    return 0;
}

static avr_cycle_count_t write_over(avr_t *avr, avr_cycle_count_t when, void *param)
{
    avr_eeprom_t *e = param;
    (void)when;
    avr_regbit_clear(avr, e->eepe);
    avr_raise_interrupt(avr, &e->ready);
    return 0;
}

static void control_write(avr_t *avr, avr_io_addr_t reg, uint8_t value, void *param)
{
    avr_eeprom_t *e = param;
    uint8_t was_master = avr_regbit_get(avr, e->eempe);
    uint8_t was_busy = avr_regbit_get(avr, e->eepe);
    uint16_t address = avr->data[e->r_eearl] | (e->r_eearh ? avr->data[e->r_eearh] << 8 : 0);
    address %= e->size; /* the chip has no more lines of address */
    avr->data[reg] = value;
    uint8_t begins = avr_regbit_get(avr, e->eepe) && was_master && !was_busy;
    avr_regbit_setto(avr, e->eepe, was_busy || begins);
    if (begins) {
        e->eeprom[address] = avr->data[e->r_eedr];
        avr_regbit_clear(avr, e->eempe);
        avr_cycle_timer_register_usec(avr, WRITE_US, write_over, e);
    } else if (avr_regbit_get(avr, e->eempe) && !was_master) {
        avr_cycle_timer_register(avr, MASTER_CYCLES, master_over, e);
    }
    if (avr_regbit_get(avr, e->eere) && !was_busy)
        avr->data[e->r_eedr] = e->eeprom[address];
    avr_regbit_clear(avr, e->eere);
}

void eeprom_attach(avr_t *avr)
{
    avr_eeprom_t *e = find(avr);
    if (!e)
        return;
    /* simavr's own hook must not run as well, so it is replaced and not added to. */
    avr->io[AVR_DATA_TO_IO(e->r_eecr)].w.c = control_write;
    avr->io[AVR_DATA_TO_IO(e->r_eecr)].w.param = e;
}

uint8_t *eeprom_bytes(const avr_t *avr)
{
    avr_eeprom_t *e = find(avr);
    return e ? e->eeprom : NULL;
}
