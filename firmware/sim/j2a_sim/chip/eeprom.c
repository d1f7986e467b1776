/* See eeprom.h. Times are those of the ATmega328P data sheet, section 8.4. */
#include "eeprom.h"

#include <stdlib.h>
#include <string.h>

#include "sim_cycle_timers.h"
#include "sim_interrupts.h"
#include "sim_time.h"

enum { WRITE_US = 3400, MASTER_CYCLES = 4, READ_HALTS = 4, WRITE_HALTS = 2, ERASED = 0xff };

/* 8.6.3: the interrupt comes as long as no write lasts. */
static void level(avr_t *avr, avr_eeprom_t *e)
{
    int wanted = e->ready.vector && avr_regbit_get(avr, e->ready.enable);
    if (wanted && !e->ready.pending && !avr_regbit_get(avr, e->eepe))
        avr_raise_interrupt(avr, &e->ready);
}

static void on_running(struct avr_irq_t *irq, uint32_t running, void *param)
{
    eeprom_t *own = param;
    (void)irq;
    if (!running)
        level(own->port->io.avr, own->port);
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
    level(avr, e);
    return 0;
}

static void halt(avr_t *avr, unsigned cycles)
{
    avr->cycle += cycles;
    avr->run_cycle_count = 0; /* the next event is nearer now: look after this instruction */
}

static void begin_write(eeprom_t *own, avr_t *avr, uint16_t address)
{
    avr_eeprom_t *e = own->port;
    e->eeprom[address] = avr->data[e->r_eedr];
    avr_regbit_clear(avr, e->eempe);
    avr_clear_interrupt(avr, &e->ready);
    own->busy_until = avr->cycle + avr_usec_to_cycles(avr, WRITE_US);
    avr_cycle_timer_register(avr, own->busy_until - avr->cycle, write_over, e);
    halt(avr, WRITE_HALTS);
}

static void control_write(avr_t *avr, avr_io_addr_t reg, uint8_t value, void *param)
{
    eeprom_t *own = param;
    avr_eeprom_t *e = own->port;
    uint8_t was_master = avr_regbit_get(avr, e->eempe);
    uint8_t was_busy = avr_regbit_get(avr, e->eepe);
    uint16_t address = avr->data[e->r_eearl] | (e->r_eearh ? avr->data[e->r_eearh] << 8 : 0);
    address %= e->size; /* the chip has no more lines of address */
    avr->data[reg] = value;
    uint8_t begins = avr_regbit_get(avr, e->eepe) && was_master && !was_busy;
    avr_regbit_setto(avr, e->eepe, was_busy || begins);
    if (begins)
        begin_write(own, avr, address);
    else if (avr_regbit_get(avr, e->eempe) && !was_master)
        avr_cycle_timer_register(avr, MASTER_CYCLES, master_over, e);
    if (avr_regbit_get(avr, e->eere) && !was_busy) {
        avr->data[e->r_eedr] = e->eeprom[address];
        halt(avr, READ_HALTS);
    }
    avr_regbit_clear(avr, e->eere);
    level(avr, e);
}

/* 8.6.3: EEPE is not cleared, for a write that has begun is completed; simavr drops all timers. */
static void reset(struct avr_io_t *io)
{
    avr_t *avr = io->avr;
    avr_eeprom_t *e = (avr_eeprom_t *)io;
    eeprom_t *own = avr->io[AVR_DATA_TO_IO(e->r_eecr)].w.param;
    if (own->busy_until <= avr->cycle)
        return;
    avr_regbit_set(avr, e->eepe);
    avr_cycle_timer_register(avr, own->busy_until - avr->cycle, write_over, e);
}

/* simavr's is as large as that of the chip that a relative runs as; see mcu.h. */
static int resize(avr_eeprom_t *e, uint16_t size)
{
    if (size == e->size)
        return 0;
    uint8_t *bytes = malloc(size);
    if (!bytes)
        return -1;
    memset(bytes, ERASED, size);
    free(e->eeprom);
    e->eeprom = bytes;
    e->size = size;
    return 0;
}

int eeprom_attach(eeprom_t *own, avr_t *avr)
{
    for (avr_io_t *io = avr->io_port; io; io = io->next)
        if (io->kind && !strcmp(io->kind, "eeprom"))
            own->port = (avr_eeprom_t *)io;
    avr_eeprom_t *e = own->port;
    if (!e)
        return 0;
    if (resize(e, avr->e2end + 1))
        return -1;
    /* simavr's own hook must not run as well, so it is replaced and not added to. */
    avr->io[AVR_DATA_TO_IO(e->r_eecr)].w.c = control_write;
    avr->io[AVR_DATA_TO_IO(e->r_eecr)].w.param = own;
    e->io.reset = reset;
    if (e->ready.vector)
        avr_irq_register_notify(e->ready.irq + AVR_INT_IRQ_RUNNING, on_running, own);
    return 0;
}
