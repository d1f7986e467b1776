/* The C half of j2a_sim: one simulated AVR behind a few plain functions, called by ctypes.
 *
 * In:  a flash image, bytes for the UART, a number of cycles to run.
 * Out: bytes of the UART with the cycle of their arrival, cycle spans, what simavr logs.
 * Nothing is printed, no signal is touched, no wall clock is read. One thread at a time may use a
 * sim_t; different ones are independent.
 *
 * Compiled on the user's machine and linked with the libsimavr found there (see _build.py).
 */
#include "simavr_shim.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "sim_avr.h"
#include "sim_core.h"
#include "adc.h"
#include "board.h"
#include "eeprom.h"
#include "growing_array.h"
#include "interrupts.h"
#include "mcu.h"
#include "memory.h"
#include "signature.h"
#include "twi.h"
#include "usart.h"

enum { STOP_OUTPUT = 1, STOP_SPAN = 2, STOP_USB = 4, STOP_WAKE = 8 }; /* what sim_run may stop for */
enum { LOG_SIZE = 8192, GPIOR0 = 0x3e, PAINT = 0xc5 };

typedef struct { uint64_t cycle; uint8_t byte, framing_error; } out_t;
typedef struct { uint64_t start, cycles; uint8_t mark; } span_t;

struct sim {
    avr_t *avr;
    usart_t usart;
    mcu_t mcu;
    interrupts_t interrupts;
    adc_t adc;
    eeprom_t eeprom;
    board_t board;
    twi_t twi;
    signature_t signature;
    usb_device_t *usb; /* NULL: the chip has none */
    usb_host_t host;
    int stop_mask, stopped;
    _Atomic uint32_t woken;
    out_t *out;
    uint32_t out_count, out_size;
    span_t *spans;
    uint32_t span_count, span_size;
    uint64_t span_start;
    uint8_t span_mark, spans_on, illegal;
    uint32_t illegal_pc, ram_end;
    char log[LOG_SIZE];
    uint32_t log_length;
};

/* ---- simavr's log ---- */

static _Thread_local char early_log[512]; /* messages that name no AVR, for sim_new's error */

static void log_message(struct avr_t *avr, const int level, const char *text, va_list arguments)
{
    char line[256];
    if (level > LOG_WARNING)
        return;
    vsnprintf(line, sizeof line, text, arguments);
    sim_t *s = avr ? avr->custom.data : NULL;
    if (!s) {
        snprintf(early_log, sizeof early_log, "%s", line);
        return;
    }
    if (strstr(line, "Invalid Opcode")) {
        s->illegal = 1;
        s->illegal_pc = avr->pc;
        s->stopped = 1;
        avr->run_cycle_count = 0;
    }
    size_t length = strlen(line);
    if (s->log_length + length < LOG_SIZE) { /* the first messages tell the cause */
        memcpy(s->log + s->log_length, line, length);
        s->log_length += length;
    }
}

/* Fills the RAM above the static data, so that one can see how deep the stack went. */
static void on_reset(void *param)
{
    sim_t *s = param;
    memset(s->avr->data + s->ram_end, PAINT, s->avr->ramend + 1u - s->ram_end);
    board_reset(&s->board);
}

/* ---- what the firmware does ---- */

static void stop_for(sim_t *s, int reason)
{
    if (s->stop_mask & reason) {
        s->stopped = 1;
        s->avr->run_cycle_count = 0; /* leaves the core's inner loop after this instruction */
    }
}

static void on_byte(void *param, uint8_t byte, int framing_error)
{
    sim_t *s = param;
    s->out = grow_array(s->out, s->out_count, &s->out_size, sizeof *s->out);
    s->out[s->out_count++] = (out_t){s->avr->cycle, byte, (uint8_t)framing_error};
    stop_for(s, STOP_OUTPUT);
}

static void on_mark(avr_t *avr, avr_io_addr_t address, uint8_t value, void *param)
{
    sim_t *s = param;
    avr->data[address] = value;
    if (s->span_mark) {
        s->spans = grow_array(s->spans, s->span_count, &s->span_size, sizeof *s->spans);
        s->spans[s->span_count++] =
            (span_t){s->span_start, avr->cycle - s->span_start, s->span_mark};
        stop_for(s, STOP_SPAN);
    }
    s->span_mark = value;
    s->span_start = avr->cycle;
}

static void on_transfer(void *param) { stop_for(param, STOP_USB); }

/* ---- life ---- */

/* As avr_callback_run_raw, but a sleeping core waits for nobody, wakes at the very cycle of the next
 * event and not one later, and keeps its memory when it sleeps for ever. */
static void run_burst(avr_t *avr)
{
    avr_flashaddr_t pc = avr->pc;
    if (avr->state == cpu_Running)
        pc = signature_run(&((sim_t *)avr->custom.data)->signature); /* and those after it, up to the next event */
    /* Events that came due during the last instruction happen at their own cycle, one after the other:
     * so edges, bytes and what they cause are stamped exactly. */
    avr_cycle_count_t now = avr->cycle;
    while (avr->cycle_timers.timer && avr->cycle_timers.timer->when < now) {
        avr->cycle = avr->cycle_timers.timer->when;
        avr_cycle_timer_process(avr);
    }
    avr->cycle = now;
    avr_cycle_count_t sleep = avr_cycle_timer_process(avr);
    avr->pc = pc;
    if (avr->state == cpu_Sleeping) {
        if (!avr->sreg[S_I]) {
            avr->state = cpu_Done;
            return;
        }
        avr->cycle += sleep ? sleep : 1;
    }
    if ((avr->state == cpu_Running || avr->state == cpu_Sleeping) && avr->interrupt_state)
        avr_service_interrupts(avr);
}

/* name 0: the first there is */
static avr_uart_t *find_uart(avr_t *avr, char name)
{
    avr_uart_t *first = NULL;
    for (avr_io_t *io = avr->io_port; io; io = io->next) {
        avr_uart_t *port = (avr_uart_t *)io;
        if (!io->kind || strcmp(io->kind, "uart"))
            continue;
        if (name ? port->name == name : !first || port->name < first->name)
            first = port;
    }
    return first;
}

static int attach_usb(sim_t *s, const uint8_t *serial)
{
    for (avr_io_t *io = s->avr->io_port; io; io = io->next) {
        if (!io->kind || strcmp(io->kind, "usb"))
            continue;
        s->usb = calloc(1, sizeof *s->usb);
        if (!s->usb)
            return -1;
        s->usb->is_u2 = mcu_is_usb162(s->avr);
        s->host.on_complete = on_transfer;
        s->host.param = s;
        signature_attach(&s->signature, s->avr, serial);
        usb_host_attach(&s->host, s->avr, s->usb);
        usb_device_attach(s->usb, s->avr, (avr_usb_t *)io);
        return 0;
    }
    return 0;
}

void sim_free(sim_t *s)
{
    if (!s)
        return;
    if (s->usb)
        usb_host_free(&s->host);
    if (s->avr) {
        avr_terminate(s->avr);
        free(s->avr);
    }
    board_free(&s->board);
    free(s->usb);
    free(s->usart.queue);
    free(s->out);
    free(s->spans);
    free(s);
}

static sim_t *failed(sim_t *s, char *error, size_t size, const char *text)
{
    snprintf(error, size, "%s%s%s", text, early_log[0] ? ": " : "", early_log);
    sim_free(s);
    return NULL;
}

sim_t *sim_new(const char *mcu, uint32_t frequency_hz, char uart, double host_bit, const uint8_t *flash,
               uint32_t flash_size, uint32_t ram_end, const uint8_t *serial, char *error, size_t error_size)
{
    avr_global_logger_set(log_message);
    early_log[0] = 0;
    sim_t *s = calloc(1, sizeof *s);
    if (!s)
        return failed(NULL, error, error_size, "out of memory");
    s->avr = mcu_make(mcu);
    if (!s->avr)
        return failed(s, error, error_size, "simavr does not know this MCU");
    avr_t *avr = s->avr;
    char text[128];
    if (flash_size > avr->flashend + 1 || ram_end > avr->ramend + 1u) {
        snprintf(text, sizeof text, "the program needs %u bytes of flash and RAM up to 0x%x, "
                 "the MCU has %u and 0x%x", flash_size, ram_end, avr->flashend + 1,
                 avr->ramend + 1u);
        free(avr);
        s->avr = NULL;
        return failed(s, error, error_size, text);
    }
    avr_init(avr);
    if (memory_widen(avr))
        return failed(s, error, error_size, "out of memory");
    if (eeprom_attach(&s->eeprom, avr))
        return failed(s, error, error_size, "out of memory");
    mcu_mend(&s->mcu, avr);
    s->signature.avr = avr;
    avr->custom.data = s;
    avr->log = LOG_WARNING;
    avr->frequency = frequency_hz;
    avr->run = run_burst;
    avr->run_cycle_limit = frequency_hz / 1000; /* how soon a run sees that it was woken */
    avr_loadcode(avr, (uint8_t *)flash, flash_size, 0);
    memory_mirror(avr);
    avr->codeend = flash_size;

    avr_uart_t *port = find_uart(avr, uart);
    if (!port)
        return failed(s, error, error_size, "the MCU has no such UART");
    s->ram_end = ram_end;
    adc_attach(&s->adc, avr);
    board_attach(&s->board, avr, &s->adc);
    twi_attach(&s->twi, avr);
    s->usart.host_bit = host_bit;
    s->usart.on_byte = on_byte;
    s->usart.on_reset = on_reset;
    s->usart.param = s;
    if (usart_attach(&s->usart, avr, port))
        return failed(s, error, error_size, "this MCU's kind of UART is not modelled");
    if (attach_usb(s, serial))
        return failed(s, error, error_size, "out of memory");
    interrupts_attach(&s->interrupts, avr);
    if (!avr->io[AVR_DATA_TO_IO(GPIOR0)].w.c) { /* else another register lives there */
        avr_register_io_write(avr, GPIOR0, on_mark, s);
        s->spans_on = 1;
    }
    return s;
}

void sim_reset(sim_t *s)
{
    s->illegal = 0;
    s->span_mark = 0;
    s->signature.state = ROW_CLOSED;
    avr_reset(s->avr);
    s->avr->state = cpu_Running;
}

static avr_cycle_count_t end_of_run(avr_t *avr, avr_cycle_count_t when, void *param)
{
    (void)avr;
    (void)when;
    ((sim_t *)param)->stopped = 1;
    return 0;
}

int sim_run(sim_t *s, uint64_t cycles, int stop_mask)
{
    avr_t *avr = s->avr;
    uint64_t end = avr->cycle + cycles;
    int state = avr->state;
    if (!cycles || s->illegal || state == cpu_Done || state == cpu_Crashed)
        return state;
    s->stop_mask = stop_mask;
    s->stopped = 0;
    /* Without this timer a sleeping core would skip to its next event, however late. */
    avr_cycle_timer_register(avr, cycles, end_of_run, s);
    while (!s->stopped && avr->cycle < end && !(stop_mask & STOP_WAKE && s->woken)) {
        state = avr_run(avr);
        if (state == cpu_Done || state == cpu_Crashed)
            break;
    }
    avr_cycle_timer_cancel(avr, end_of_run, s);
    return state;
}

int sim_run_output(sim_t *s, uint64_t gap, uint32_t most)
{
    uint32_t before;
    int state;
    do {
        before = s->out_count;
        state = sim_run(s, gap, STOP_OUTPUT | STOP_WAKE);
    } while (before < s->out_count && s->out_count < most);
    return state;
}

/* ---- what the host sees ---- */

uint64_t sim_cycle(const sim_t *s) { return s->avr->cycle; }
uint64_t *sim_cycle_place(sim_t *s) { return &s->avr->cycle; }
uint32_t sim_pc(const sim_t *s) { return s->illegal ? s->illegal_pc : s->avr->pc; }
int sim_illegal(const sim_t *s) { return s->illegal; }
int sim_spans_on(const sim_t *s) { return s->spans_on; }
uint8_t *sim_data(const sim_t *s) { return s->avr->data; }
uint32_t sim_flash_size(const sim_t *s) { return s->avr->flashend + 1; }
uint32_t sim_data_size(const sim_t *s) { return s->avr->ramend + 1u; }
const char *sim_log(const sim_t *s) { return s->log; }

uint8_t *sim_eeprom(const sim_t *s) { return s->eeprom.port ? s->eeprom.port->eeprom : NULL; }

uint32_t sim_eeprom_size(const sim_t *s) { return s->eeprom.port ? s->eeprom.port->size : 0; }

usb_host_t *sim_usb(sim_t *s) { return s->usb ? &s->host : NULL; }

int sim_feed(sim_t *s, const uint8_t *data, uint32_t n) { return usart_feed(&s->usart, data, n); }
double sim_bit_cycles(const sim_t *s) { return usart_bit_cycles(&s->usart); }
unsigned sim_char_bits(const sim_t *s) { return usart_char_bits(&s->usart); }
int sim_receiver_on(const sim_t *s) { return usart_receiver_on(&s->usart); }

void sim_counters(const sim_t *s, uint64_t *to)
{
    const usart_t *u = &s->usart;
    uint64_t all[] = {u->bytes_in, u->bytes_out, u->overruns, u->unheard, u->rx_framing_errors,
                      u->tx_framing_errors, u->tx_ignored, u->queue_count};
    memcpy(to, all, sizeof all);
}

uint32_t sim_out_count(const sim_t *s) { return s->out_count; }
uint32_t *sim_out_count_place(sim_t *s) { return &s->out_count; }
uint32_t *sim_woken_place(sim_t *s) { return (uint32_t *)&s->woken; }
uint32_t sim_span_count(const sim_t *s) { return s->span_count; }

void sim_take_out(sim_t *s, uint32_t n, uint8_t *bytes, uint64_t *cycles)
{
    for (uint32_t i = 0; i < n; i++) {
        bytes[i] = s->out[i].byte;
        if (cycles)
            cycles[i] = s->out[i].cycle;
    }
    s->out_count -= n;
    memmove(s->out, s->out + n, s->out_count * sizeof *s->out);
}

void sim_take_spans(sim_t *s, uint8_t *marks, uint64_t *starts, uint64_t *cycles)
{
    for (uint32_t i = 0; i < s->span_count; i++) {
        marks[i] = s->spans[i].mark;
        starts[i] = s->spans[i].start;
        cycles[i] = s->spans[i].cycles;
    }
    s->span_count = 0;
}

void sim_drop_untaken(sim_t *s, uint32_t most)
{
    if (s->out_count > most)
        s->out_count = 0;
    if (s->span_count > most)
        s->span_count = 0;
}

int sim_interrupt(const sim_t *s, int vector, uint64_t *to)
{
    const interrupt_t *i = &s->interrupts.of[vector & (VECTORS - 1)];
    uint64_t all[] = {i->count, i->longest, i->total, i->latest};
    memcpy(to, all, sizeof all);
    return i->avr != NULL;
}

void sim_clear_interrupts(sim_t *s) { interrupts_clear(&s->interrupts); }

/* ---- what is wired to the pins ---- */

int sim_pin(const sim_t *s, char port, int bit) { return board_pin(&s->board, port, bit); }
int sim_pin_level(const sim_t *s, int pin) { return board_level(&s->board, pin); }
void sim_watch(sim_t *s, int pin) { board_watch(&s->board, pin); }
uint32_t sim_edge_count(const sim_t *s, int pin) { return board_edge_count(&s->board, pin); }
uint32_t sim_waiting(const sim_t *s) { return board_waiting(&s->board); }

void sim_take_edges(sim_t *s, int pin, uint64_t *cycles, uint8_t *levels)
{
    board_take_edges(&s->board, pin, cycles, levels);
}

void sim_drive(sim_t *s, uint64_t cycle, int pin, int level)
{
    board_schedule(&s->board, cycle, pin, level);
}

int sim_has_adc(const sim_t *s) { return s->adc.port != NULL; }
uint64_t sim_conversions(const sim_t *s) { return s->adc.conversions; }

void sim_set_volts(sim_t *s, uint64_t cycle, int channel, double volts)
{
    board_schedule(&s->board, cycle, BOARD_PORTS * 8 + channel, volts);
}

void sim_set_references(sim_t *s, double avcc, double aref)
{
    s->adc.avcc = avcc;
    s->adc.aref = aref;
}

/* ---- the wires of the TWI ---- */

int sim_has_twi(const sim_t *s) { return s->twi.port != NULL; }

void sim_set_srf02(sim_t *s, int address, int kind, uint32_t cm)
{
    s->twi.sensors[address].kind = kind;
    s->twi.sensors[address].cm = cm;
}

uint32_t sim_srf02_measurements(const sim_t *s, int address) { return s->twi.sensors[address].measurements; }
void sim_hang_twi(sim_t *s, int on) { s->twi.stuck = on; }
