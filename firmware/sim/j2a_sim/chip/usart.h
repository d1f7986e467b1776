/* The serial wire of the simulated AVR, exact to the cycle.
 *
 * In:  bytes of the host (usart_feed), register accesses of the firmware.
 * Out: bytes that the host's UART receives (the on_byte callback), interrupts and flags of the AVR.
 *
 * It takes the place of simavr's own UART model, which counts eleven bit times for every
 * character, holds 64 received bytes and raises its interrupts once per character time. Here a
 * character takes the time that the baud and format registers say, the receiver holds two
 * characters and one more in its shift register, and the interrupt flags are levels.
 */
#ifndef J2A_SIM_USART_H
#define J2A_SIM_USART_H

#include <stdint.h>

#include "sim_avr.h"
#include "avr_uart.h"
#include "wire.h"

enum { RX_FIFO = 2 };

typedef struct {
    avr_t *avr;
    avr_uart_t *port;
    double host_bit;                    /* cycles per bit of the host; 0: the firmware's own rate */
    void (*on_byte)(void *param, uint8_t byte, int framing_error);
    void (*on_reset)(void *param);      /* the chip was reset, by its watchdog perhaps */
    void *param;

    wire_t rx, tx;
    uint8_t *queue;                     /* bytes that the host still has to send */
    uint32_t queue_head, queue_count, queue_size;
    double host_free;                   /* when the host's transmitter has sent its last stop bit */
    int host_sending;

    uint8_t fifo[RX_FIFO], fifo_flags[RX_FIFO], shift, shift_flags;
    int fifo_count, shift_full;
    uint8_t tx_buffer;
    int tx_buffered, tx_shifting;

    uint64_t bytes_in, bytes_out, overruns, unheard, rx_framing_errors, tx_framing_errors,
        tx_ignored;
} usart_t;

/* Takes over the port; returns 0, or -1 when this MCU's UART is of a kind that is not modelled. */
int usart_attach(usart_t *, avr_t *, avr_uart_t *port);
/* Queues bytes of the host, sent one after the other at wire rate; returns 0, or -1: no memory. */
int usart_feed(usart_t *, const uint8_t *data, uint32_t count);
/* Cycles of one bit and of one character (start, data, parity, stop) with the present registers. */
double usart_bit_cycles(const usart_t *);
unsigned usart_char_bits(const usart_t *);
int usart_receiver_on(const usart_t *);

#endif
