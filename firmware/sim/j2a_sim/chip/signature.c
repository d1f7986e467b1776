/* See signature.h. */
#include "signature.h"

#include <string.h>

#include "sim_core.h"

enum { SPMCSR = 0x57, SPMEN = 1, SIGRD = 0x20, EECR = 0x3f, EEPE = 2, Z = 30 };
enum { ROW_SIZE = 0x20, SERIAL_AT = 0x0e, CYCLES = 3 };

static uint8_t byte_of(const signature_t *s, unsigned address)
{
    if (address >= SERIAL_AT && address < SERIAL_AT + SIGNATURE_SERIAL)
        return s->serial[address - SERIAL_AT];
    return address <= 4 && address % 2 == 0 ? s->avr->signature[address / 2] : 0xff;
}

static void on_spmcsr(avr_t *avr, avr_io_addr_t reg, uint8_t value, void *param)
{
    signature_t *s = param;
    if (avr->data[EECR] & EEPE) /* "EEPROM write prevents writing to SPMCSR" */
        return;
    s->state = ROW_CLOSED;
    if (value != (SIGRD | SPMEN)) {
        s->write(avr, reg, value, s->param);
        return;
    }
    avr->data[reg] = value;
    s->state = ROW_ASKED;
    avr->run_cycle_count = 0; /* leaves the core's inner loop after this instruction */
}

static int is_lpm(uint16_t opcode) { return opcode == 0x95c8 || (opcode & 0xfe0e) == 0x9004; }

avr_flashaddr_t signature_run(signature_t *s)
{
    avr_t *avr = s->avr;
    if (s->state == ROW_CLOSED)
        return avr_run_one(avr);
    if (s->state == ROW_ASKED) {
        s->state = ROW_OPEN;
        s->until = avr->cycle + CYCLES;
    }
    int may_read = avr->cycle < s->until;
    uint16_t address = avr->data[Z] | avr->data[Z + 1] << 8;
    if (may_read && !is_lpm(avr->flash[avr->pc] | avr->flash[avr->pc + 1] << 8)) {
        avr->run_cycle_count = 1; /* this instruction and no other */
        return avr_run_one(avr);
    }
    s->state = ROW_CLOSED;
    avr->data[SPMCSR] &= ~(SIGRD | SPMEN);
    if (!may_read || address >= ROW_SIZE)
        return avr_run_one(avr);
    uint8_t *cell = &avr->flash[address], code = *cell;
    *cell = byte_of(s, address);
    avr->run_cycle_count = 1;
    avr_flashaddr_t pc = avr_run_one(avr);
    *cell = code;
    return pc;
}

void signature_attach(signature_t *s, avr_t *avr, const uint8_t *serial)
{
    s->avr = avr;
    memcpy(s->serial, serial, sizeof s->serial);
    s->write = avr->io[AVR_DATA_TO_IO(SPMCSR)].w.c;
    s->param = avr->io[AVR_DATA_TO_IO(SPMCSR)].w.param;
    avr->io[AVR_DATA_TO_IO(SPMCSR)].w.c = on_spmcsr;
    avr->io[AVR_DATA_TO_IO(SPMCSR)].w.param = s;
}
