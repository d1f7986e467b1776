/* See usart.h. Section numbers are those of the ATmega328P data sheet's USART0 chapter. */
#include "usart.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "sim_cycle_timers.h"
#include "sim_interrupts.h"

enum { FLAG_UPE = 1 << 2, FLAG_DOR = 1 << 3, FLAG_FE = 1 << 4, FLAGS_RX = 0x1c };
enum { UCSRA_U2X = 1 << 1, UCSRA_MPCM = 1 << 0, UCSRA_TXC = 1 << 6 };

static avr_io_addr_t ucsra(const usart_t *u) { return u->port->rxc.raised.reg; }
static avr_io_addr_t ucsrb(const usart_t *u) { return u->port->rxen.reg; }
static uint8_t *flags(const usart_t *u) { return &u->avr->data[ucsra(u)]; }

static wire_format_t format(const usart_t *u)
{
    static const uint8_t data_bits[8] = {5, 6, 7, 8, 8, 8, 8, 9};
    uint8_t c = u->avr->data[u->port->usbs.reg];
    unsigned size = ((c >> 1) & 3) | (avr_regbit_get(u->avr, u->port->ucsz2) ? 4 : 0);
    wire_format_t f = {data_bits[size], (c >> 4) & 3, 1 + ((c >> 3) & 1)};
    return f;
}

double usart_bit_cycles(const usart_t *u)
{
    unsigned ubrr = u->avr->data[u->port->ubrrl.reg]
        | (u->avr->data[u->port->ubrrh.reg] & 0x0f) << 8;
    return (ubrr + 1) * ((*flags(u) & UCSRA_U2X) ? 8 : 16);
}

unsigned usart_char_bits(const usart_t *u)
{
    return wire_char_bits(format(u));
}

int usart_receiver_on(const usart_t *u) { return avr_regbit_get(u->avr, u->port->rxen) != 0; }

/* ---- interrupts: RXC and UDRE are levels, TXC is latched until its handler starts ---- */

static void level(usart_t *u, avr_int_vector_t *v)
{
    if (v->vector && !v->pending && avr_regbit_get(u->avr, v->raised)
        && avr_regbit_get(u->avr, v->enable))
        avr_raise_interrupt(u->avr, v);
}

static void levels(usart_t *u)
{
    level(u, &u->port->rxc);
    level(u, &u->port->txc);
    level(u, &u->port->udrc);
}

static void set_flag(usart_t *u, avr_int_vector_t *v)
{
    avr_regbit_set(u->avr, v->raised);
    level(u, v);
}

static void clear_flag(usart_t *u, avr_int_vector_t *v)
{
    avr_clear_interrupt(u->avr, v);
    avr_regbit_clear(u->avr, v->raised);
}

/* A handler that returns without serving its flag is entered again, as on the chip. */
static void on_running(struct avr_irq_t *irq, uint32_t running, void *param)
{
    (void)irq;
    if (!running)
        levels(param);
}

/* ---- what the wire asks ---- */

static wire_format_t wire_format(void *param) { return format(param); }
static double avr_bit(void *param) { return usart_bit_cycles(param); }

static double host_bit(void *param)
{
    const usart_t *u = param;
    return u->host_bit > 0 ? u->host_bit : usart_bit_cycles(u);
}

/* ---- host to AVR ---- */

static avr_cycle_count_t host_next(avr_t *avr, avr_cycle_count_t when, void *param)
{
    usart_t *u = param;
    (void)when;
    if (!u->queue_count) {
        u->host_sending = 0;
        return 0;
    }
    uint8_t byte = u->queue[u->queue_head];
    u->queue_head = (u->queue_head + 1) % u->queue_size;
    u->queue_count--;
    u->bytes_in++;
    if (!usart_receiver_on(u))
        u->unheard++;
    u->host_free = wire_send(&u->rx, u->host_free, host_bit(u), byte);
    avr_cycle_count_t next = (avr_cycle_count_t)ceil(u->host_free);
    return next > avr->cycle ? next : avr->cycle + 1;
}

static void host_start(usart_t *u)
{
    if (u->host_free < u->avr->cycle)
        u->host_free = u->avr->cycle;
    u->host_sending = 1;
    avr_cycle_timer_register(u->avr, ceil(u->host_free) - u->avr->cycle + 1, host_next, u);
}

int usart_feed(usart_t *u, const uint8_t *data, uint32_t count)
{
    if (u->queue_count + count > u->queue_size) {
        uint32_t size = 2 * (u->queue_count + count) + 64;
        uint8_t *queue = malloc(size);
        if (!queue)
            return -1;
        for (uint32_t i = 0; i < u->queue_count; i++)
            queue[i] = u->queue[(u->queue_head + i) % u->queue_size];
        free(u->queue);
        u->queue = queue;
        u->queue_size = size;
        u->queue_head = 0;
    }
    for (uint32_t i = 0; i < count; i++)
        u->queue[(u->queue_head + u->queue_count++) % u->queue_size] = data[i];
    if (!u->host_sending && count)
        host_start(u);
    return 0;
}

/* 20.7.4: the overrun comes when both buffers and the shift register are full and a new start bit
 * is seen; what waits in the shift register is overwritten. */
static void rx_edge(void *param)
{
    usart_t *u = param;
    if (u->shift_full) {
        u->shift_full = 0;
        u->overruns++;
        *flags(u) |= FLAG_DOR;
    }
}

static void show_head(usart_t *u)
{
    *flags(u) = (*flags(u) & ~(FLAG_FE | FLAG_UPE)) | (u->fifo_count ? u->fifo_flags[0] : 0);
}

static void rx_push(usart_t *u, uint8_t byte, uint8_t error)
{
    u->fifo[u->fifo_count] = byte;
    u->fifo_flags[u->fifo_count++] = error;
    show_head(u);
    set_flag(u, &u->port->rxc);
}

static void rx_deliver(void *param, uint8_t byte, int framing_error, int parity_error)
{
    usart_t *u = param;
    uint8_t error = (framing_error ? FLAG_FE : 0) | (parity_error ? FLAG_UPE : 0);
    u->rx_framing_errors += framing_error;
    if (u->fifo_count < RX_FIFO) {
        rx_push(u, byte, error);
    } else {
        u->shift = byte;
        u->shift_flags = error;
        u->shift_full = 1;
    }
}

static uint8_t udr_read(avr_t *avr, avr_io_addr_t addr, void *param)
{
    usart_t *u = param;
    uint8_t byte = 0;
    if (u->fifo_count) {
        byte = u->fifo[0];
        u->fifo[0] = u->fifo[1];
        u->fifo_flags[0] = u->fifo_flags[1];
        u->fifo_count--;
    }
    *flags(u) &= ~FLAG_DOR;
    if (u->shift_full) {
        u->shift_full = 0;
        rx_push(u, u->shift, u->shift_flags);
    }
    show_head(u);
    if (!u->fifo_count)
        clear_flag(u, &u->port->rxc);
    avr->data[addr] = byte;
    return byte;
}

static void rx_flush(usart_t *u)
{
    u->fifo_count = u->shift_full = 0;
    *flags(u) &= ~FLAGS_RX;
    clear_flag(u, &u->port->rxc);
}

/* ---- AVR to host ---- */

static avr_cycle_count_t tx_done(avr_t *avr, avr_cycle_count_t when, void *param);

static void tx_start(usart_t *u, double start, uint8_t byte)
{
    u->tx_shifting = 1;
    double end = wire_send(&u->tx, start, usart_bit_cycles(u), byte);
    double delay = ceil(end) - u->avr->cycle;
    avr_cycle_timer_register(u->avr, delay < 1 ? 1 : (avr_cycle_count_t)delay, tx_done, u);
}

static avr_cycle_count_t tx_done(avr_t *avr, avr_cycle_count_t when, void *param)
{
    usart_t *u = param;
    (void)avr;
    u->tx_shifting = 0;
    if (u->tx_buffered) {
        u->tx_buffered = 0;
        tx_start(u, when, u->tx_buffer);
        set_flag(u, &u->port->udrc);
    } else {
        set_flag(u, &u->port->txc);
    }
    return 0;
}

static void tx_deliver(void *param, uint8_t byte, int framing_error, int parity_error)
{
    usart_t *u = param;
    (void)parity_error;
    u->bytes_out++;
    u->tx_framing_errors += framing_error;
    u->on_byte(u->param, byte, framing_error);
}

static void udr_write(avr_t *avr, avr_io_addr_t addr, uint8_t byte, void *param)
{
    usart_t *u = param;
    (void)addr;
    if (!avr_regbit_get(avr, u->port->txen) || u->tx_buffered) {
        u->tx_ignored++; /* 20.6.1: data written while UDRE is clear is ignored */
        return;
    }
    if (u->tx_shifting) {
        u->tx_buffered = 1;
        u->tx_buffer = byte;
        clear_flag(u, &u->port->udrc);
    } else {
        tx_start(u, avr->cycle, byte);
        level(u, &u->port->udrc);
    }
}

/* ---- registers ---- */

static void ucsra_write(avr_t *avr, avr_io_addr_t addr, uint8_t v, void *param)
{
    usart_t *u = param;
    const uint8_t writable = UCSRA_U2X | UCSRA_MPCM;
    avr->data[addr] = (avr->data[addr] & ~writable) | (v & writable);
    if (v & UCSRA_TXC)
        clear_flag(u, &u->port->txc);
}

static void ucsrb_write(avr_t *avr, avr_io_addr_t addr, uint8_t v, void *param)
{
    usart_t *u = param;
    avr->data[addr] = v & ~2; /* RXB8 cannot be written */
    wire_listen(&u->rx, usart_receiver_on(u));
    if (!usart_receiver_on(u))
        rx_flush(u);
    levels(u);
}

static void reset(struct avr_io_t *io)
{
    /* simavr hands over the port, which is the first member of avr_uart_t; its data register's
     * hook knows us. */
    usart_t *u = io->avr->io[AVR_DATA_TO_IO(((avr_uart_t *)io)->r_udr)].w.param;
    avr_cycle_timer_cancel(u->avr, tx_done, u);
    wire_listen(&u->rx, 0);
    u->avr->data[u->port->usbs.reg] = 6; /* 8N1, for what the host makes of a character that is cut, too */
    wire_cut(&u->tx);
    u->tx_buffered = u->tx_shifting = 0;
    rx_flush(u);
    clear_flag(u, &u->port->txc);
    u->avr->data[ucsra(u)] = 0;
    u->avr->data[ucsrb(u)] = 0;
    avr_regbit_set(u->avr, u->port->udrc.raised);
    if (u->host_sending) /* the host's transmitter knows of no reset; simavr drops all timers */
        host_start(u);
    u->on_reset(u->param);
}

int usart_attach(usart_t *u, avr_t *avr, avr_uart_t *port)
{
    u->avr = avr;
    u->port = port;
    /* A LIN port has no UDRE; older chips keep UCSRC and UBRRH at one address. */
    if (!port->udrc.vector || !port->usbs.reg || port->usbs.reg == port->ubrrh.reg)
        return -1;
    u->rx = (wire_t){.avr = avr, .user = u, .format = wire_format, .receiver_bit = avr_bit,
                     .edge = rx_edge, .deliver = rx_deliver};
    u->tx = (wire_t){.avr = avr, .user = u, .format = wire_format, .receiver_bit = host_bit,
                     .deliver = tx_deliver, .listens = 1};

    /* simavr's own hooks must not run as well, so they are replaced and not added to. */
#define HOOK(address, direction, function, user)                    \
    do {                                                            \
        avr->io[AVR_DATA_TO_IO(address)].direction.c = function;    \
        avr->io[AVR_DATA_TO_IO(address)].direction.param = user;    \
    } while (0)
    HOOK(port->r_udr, r, udr_read, u);
    HOOK(port->r_udr, w, udr_write, u);
    HOOK(ucsra(u), r, NULL, NULL);
    HOOK(ucsra(u), w, ucsra_write, u);
    HOOK(ucsrb(u), w, ucsrb_write, u);
    HOOK(port->ubrrl.reg, w, NULL, NULL);
#undef HOOK
    port->io.reset = reset;
    reset(&port->io);

    avr_int_vector_t *vectors[] = {&port->rxc, &port->txc, &port->udrc};
    for (int i = 0; i < 3; i++)
        avr_irq_register_notify(vectors[i]->irq + AVR_INT_IRQ_RUNNING, on_running, u);
    return 0;
}
