/* A port on top of a board's few functions (board.h). Nothing is to be filled in here.
 * Bytes flow from the UART into a ring, and from there into the parser; to the UART they flow at once.
 * With BOARD_INTERRUPTS 0 whatever waits also receives; a function that computes for longer than the
 * UART's own buffer lasts loses bytes, which is noticed. With 1 the receive interrupt fills the ring.
 * Rules: the producer (port_receive) writes only `head`, the consumer (j2a_port_rx) only `tail`, so
 * neither needs a lock. After a loss nothing is stored until the ring is empty and the parser knows
 * of the loss, so that bytes from before and after it never end up in one frame. */
#include "board.h"
#include "j2a_port.h"

/* Both sides must read an index in one step: on a chip of 8 bits keep J2A_RXBUF below 256. */
#if J2A_RXBUF < 256
typedef uint8_t ring_index;
#else
typedef uint16_t ring_index;
#endif
#if J2A_RXBUF > 65535
#error "J2A_RXBUF must be 1..65535"
#endif

enum { BYTES_IN_A_ROW = 32 }; /* then the main loop goes on, also when bytes come without end */

static volatile uint8_t ring[J2A_RXBUF + 1u]; /* one place stays free, so that full and empty differ */
static volatile ring_index head, tail;
static volatile bool lost;
static uint16_t overruns;

static ring_index after(ring_index index) {
    return index == J2A_RXBUF ? 0 : (ring_index)(index + 1);
}

/* Takes one byte from the UART into the ring. */
#if !BOARD_INTERRUPTS
static
#endif
void port_receive(void) {
    const bool lost_before = board_lost();
    const uint8_t byte = board_read();

    if (!lost) {
        const ring_index next = after(head);
        if (lost_before || next == tail) {
            lost = true;
        } else {
            ring[head] = byte;
            head = next;
        }
    }
}

/* While the ring is full bytes stay where they are: a pipe makes the host wait, a UART loses them and
 * says so. */
static void poll_receiver(void) {
#if !BOARD_INTERRUPTS
    uint8_t i;
    for (i = 0; i < BYTES_IN_A_ROW && after(head) != tail && board_has_byte(); i++)
        port_receive();
#endif
}

void j2a_port_init(int argc, char **argv) {
    (void)argc;
    (void)argv;
    board_init();
}

int16_t j2a_port_rx(void) {
    bool after_loss;
    poll_receiver();
    /* Read before the ring is looked at: once it is set the ring gets no more, so "empty" stays true. */
    after_loss = lost;
    if (tail != head) {
        const uint8_t byte = ring[tail];
        tail = after(tail);
        return byte;
    }
    if (after_loss) {
        j2a_rx_lost();
        overruns++;
        lost = false;
    }
    return -1;
}

void j2a_port_tx(uint8_t byte) {
    while (!board_can_write())
        poll_receiver();
    board_write(byte);
    poll_receiver();
}

uint16_t j2a_port_ticks(void) {
    return (uint16_t)board_ms();
}

uint64_t j2a_port_time_us(void) {
    static uint32_t last_ms, wraps;
    const uint32_t now_ms = board_ms();
    if (now_ms < last_ms)
        wraps++;
    last_ms = now_ms;
    poll_receiver(); /* a function that waits looks at the clock */
    return ((uint64_t)wraps << 32 | now_ms) * 1000;
}

uint16_t j2a_port_overruns(void) {
    return overruns;
}

void j2a_port_idle(void) {
    poll_receiver();
    board_idle();
}
