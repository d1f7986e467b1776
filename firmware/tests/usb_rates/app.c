/* Loads a link as much as it can be, and marks what that costs with GPIOR0, for a simulator that counts the cycles
 * between two writes:
 *   mark 1: j2a_poll() with what has come in a millisecond
 *   mark 2: j2a_process()
 *   mark 3: j2a_send_sif()
 * With RATES_MARKS=0 it runs as fast as it can and marks nothing. Rule: no byte of a frame is escaped, so bytes of
 * a frame are bytes on the wire. */
#include <avr/io.h>
#include <util/delay.h>

#include "j2a_functions.h"

enum { SIF = 1, BYTES = 249 };

static uint8_t bytes[BYTES];
static uint8_t chunk = BYTES;
static uint16_t sifs;

#if RATES_MARKS
#define MARKED(mark, call) do { \
    GPIOR0 = mark; \
    call; \
    GPIOR0 = 0; \
} while (0)
#else
#define MARKED(mark, call) call
#endif

/* Takes one byte: how many source() and the SIFs have from now on, up to 249. */
uint8_t rates_chunk(uint8_t *const length, uint8_t **const payload) {
    chunk = **payload;
    *length = 0;
    return 0;
}

/* Takes u16: how many SIFs to send, one after the other. */
uint8_t rates_sifs(uint8_t *const length, uint8_t **const payload) {
    sifs = (uint16_t)((*payload)[0] | (uint16_t)(*payload)[1] << 8);
    *length = 0;
    return 0;
}

/* Takes all and keeps nothing. */
uint8_t rates_sink(bool *is_last, bool is_write, uint32_t *const offset, uint8_t *const length,
                   uint8_t **const data) {
    (void)is_last;
    (void)is_write;
    (void)offset;
    (void)data;
    *length = 0;
    return 0;
}

/* Has no end. */
uint8_t rates_source(bool *is_last, bool is_write, uint32_t *const offset, uint8_t *const length,
                     uint8_t **const data) {
    (void)is_write;
    (void)offset;
    *is_last = false;
    *length = chunk;
    *data = bytes;
    return 0;
}

int main(void) {
    uint8_t i;

    for (i = 0; i < BYTES; i++)
        bytes[i] = (uint8_t)(0x80 + (i & 0x3F));
    j2a_port_init(0, 0);
    for (;;) {
#if RATES_MARKS
        _delay_ms(1);
#endif
        if (sifs != 0) {
            sifs--;
            MARKED(3, j2a_send_sif(SIF, chunk, bytes));
        }
        MARKED(1, j2a_poll());
        MARKED(2, j2a_process());
        j2a_port_idle();
    }
}
