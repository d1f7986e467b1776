/* See memory.h. */
#include "memory.h"

#include <stdlib.h>
#include <string.h>

#include "avr_eeprom.h"
#include "avr_uart.h"

enum { DATA_SPACE = 0x10000, Z_SPACE = 0x10000 };
/* simavr forms the address of ELPM and SPM from Z and a whole byte, on a chip without RAMPZ from r0;
 * SPM erases a page from there on. Pages that nothing touches cost no memory. */
enum { FLASH_SPACE = 0x1000000 + Z_SPACE };

static void *widened(uint8_t *old, size_t old_size, size_t size)
{
    uint8_t *wide = calloc(size, 1);
    if (!wide)
        return NULL;
    memcpy(wide, old, old_size);
    free(old);
    return wide;
}

static void write_rampz(avr_t *avr, avr_io_addr_t reg, uint8_t value, void *param)
{
    (void)param;
    avr->data[reg] = value & avr->flashend >> 16;
}

static void write_eearl(avr_t *avr, avr_io_addr_t reg, uint8_t value, void *param)
{
    (void)param;
    avr->data[reg] = value & avr->e2end;
}

static void write_eearh(avr_t *avr, avr_io_addr_t reg, uint8_t value, void *param)
{
    (void)param;
    avr->data[reg] = value & avr->e2end >> 8;
}

static void bound_eeprom(avr_t *avr, const avr_eeprom_t *eeprom)
{
    avr_register_io_write(avr, eeprom->r_eearl, write_eearl, NULL);
    if (eeprom->r_eearh)
        avr_register_io_write(avr, eeprom->r_eearh, write_eearh, NULL);
}

int memory_widen(avr_t *avr)
{
    uint8_t *data = widened(avr->data, avr->ramend + 1u, DATA_SPACE);
    if (data)
        avr->data = data;
    uint8_t *flash = widened(avr->flash, avr->flashend + 1u, FLASH_SPACE);
    if (flash)
        avr->flash = flash;
    if (!data || !flash)
        return -1;
    if (avr->rampz)
        avr_register_io_write(avr, avr->rampz, write_rampz, NULL);
    for (avr_io_t *io = avr->io_port; io; io = io->next) {
        if (!io->kind)
            continue;
        if (!strcmp(io->kind, "uart"))
            ((avr_uart_t *)io)->flags = 0; /* it logs lines of text, and writes past the longest */
        if (!strcmp(io->kind, "eeprom"))
            bound_eeprom(avr, (avr_eeprom_t *)io);
    }
    return 0;
}

void memory_mirror(avr_t *avr)
{
    uint32_t size = avr->flashend + 1;
    for (uint32_t at = size; at < Z_SPACE; at += size)
        memcpy(avr->flash + at, avr->flash, size);
}
