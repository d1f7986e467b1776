/* The functions of the shim, as j2a_sim calls them: _prototypes.py reads their types from this header and
 * from usb_host.h. */
#ifndef J2A_SIM_SIMAVR_SHIM_H
#define J2A_SIM_SIMAVR_SHIM_H

#include <stddef.h>
#include <stdint.h>

#include "usb_host.h"

typedef struct sim sim_t;

/* Returns NULL with a text in `error` when the MCU is unknown, too small or without that UART. */
sim_t *sim_new(const char *mcu, uint32_t frequency_hz, char uart, double host_bit, const uint8_t *flash,
               uint32_t flash_size, uint32_t ram_end, const uint8_t *serial, char *error, size_t error_size);
void sim_free(sim_t *);
void sim_reset(sim_t *);
/* Runs `cycles` cycles, or less if one of the `stop_mask` events comes; returns simavr's state. */
int sim_run(sim_t *, uint64_t cycles, int stop_mask);
/* Runs until `most` received bytes wait, none has come for `gap` cycles, or it is woken; returns simavr's state. */
int sim_run_output(sim_t *, uint64_t gap, uint32_t most);

uint64_t sim_cycle(const sim_t *);
uint64_t *sim_cycle_place(sim_t *);      /* where it stands, for who looks often */
uint32_t sim_pc(const sim_t *);
int sim_illegal(const sim_t *);
int sim_spans_on(const sim_t *);
uint8_t *sim_data(const sim_t *);
uint32_t sim_flash_size(const sim_t *);
uint32_t sim_data_size(const sim_t *);
const char *sim_log(const sim_t *);
/* The EEPROM, which a reset leaves as it is; NULL and 0 on a chip without one. */
uint8_t *sim_eeprom(const sim_t *);
uint32_t sim_eeprom_size(const sim_t *);

usb_host_t *sim_usb(sim_t *); /* NULL: the chip has none */

int sim_feed(sim_t *, const uint8_t *data, uint32_t n);
double sim_bit_cycles(const sim_t *);
unsigned sim_char_bits(const sim_t *);
int sim_receiver_on(const sim_t *);
/* Copies the counters in the order of _build.COUNTERS. */
void sim_counters(const sim_t *, uint64_t *to);

uint32_t sim_out_count(const sim_t *);
uint32_t *sim_out_count_place(sim_t *);
uint32_t *sim_woken_place(sim_t *);       /* not 0, from any thread, ends a run with STOP_WAKE within 1 ms */
uint32_t sim_span_count(const sim_t *);
/* Takes the first `n` received bytes away; `cycles` may be NULL. */
void sim_take_out(sim_t *, uint32_t n, uint8_t *bytes, uint64_t *cycles);
/* Takes all closed spans away; the arrays hold sim_span_count() items. */
void sim_take_spans(sim_t *, uint8_t *marks, uint64_t *starts, uint64_t *cycles);
/* Drops received bytes and closed spans that nobody has taken, of either where there are more than `most`. */
void sim_drop_untaken(sim_t *, uint32_t most);
/* Copies what is known of an interrupt vector; see interrupts.h. Returns 0 for one that does not exist. */
int sim_interrupt(const sim_t *, int vector, uint64_t *to);
void sim_clear_interrupts(sim_t *);

/* ---- what is wired to the pins; see board.h ---- */
int sim_pin(const sim_t *, char port, int bit);
int sim_pin_level(const sim_t *, int pin);
void sim_watch(sim_t *, int pin);
uint32_t sim_edge_count(const sim_t *, int pin);
uint32_t sim_waiting(const sim_t *);
void sim_take_edges(sim_t *, int pin, uint64_t *cycles, uint8_t *levels);
void sim_drive(sim_t *, uint64_t cycle, int pin, int level);
int sim_has_adc(const sim_t *);
uint64_t sim_conversions(const sim_t *);
void sim_set_volts(sim_t *, uint64_t cycle, int channel, double volts);
void sim_set_references(sim_t *, double avcc, double aref);

/* ---- the wires of the TWI; see twi.h ---- */
int sim_has_twi(const sim_t *);
/* address: 0 to 127. kind: TWI_ABSENT and so on. */
void sim_set_srf02(sim_t *, int address, int kind, uint32_t cm);
uint32_t sim_srf02_measurements(const sim_t *, int address);
void sim_hang_twi(sim_t *, int on);

#endif
