/* Values that come from an interrupt while the main loop sends samples of two channels. Each basic block of the engine is
 * compiled to call __sanitizer_cov_trace_pc(), and there an interrupt may come.
 * In: channel of the interrupts, blocks up to each of them, how many there may be in the first three turns. Out: a line
 * for each turn of the main loop, with the values of both channels where a sample SIF was sent; then the code
 * and the length of SAMPLE while a driver writes, and behind it; and how many interrupts came. */
#include <stdio.h>
#include <stdlib.h>

#include "j2a_transds.h"
#include "transds.h"

static void (*both)(uint8_t channel, uint8_t value);
static uint8_t channel_of_interrupt, last;
static int every, blocks, most, came;

void both_set_cb(void (*callback)(uint8_t channel, uint8_t value)) {
    both = callback;
}

void __sanitizer_cov_trace_pc(void);
void __sanitizer_cov_trace_pc(void) {
    static bool is_inside;
    if (is_inside || came == most || ++blocks != every)
        return;
    is_inside = true;
    blocks = 0;
    came++;
    both(channel_of_interrupt, ++last);
    is_inside = false;
}

uint64_t j2a_port_time_us(void) {
    return 1;
}

uint16_t j2a_port_ticks(void) {
    return 0;
}

int16_t j2a_port_rx(void) {
    return -1;
}

/* Instead of the core's: a sample SIF has a time and a value of each channel. */
void j2a_send(uint8_t start, uint8_t seq, uint8_t opcode, uint8_t length, const uint8_t *payload) {
    (void)start;
    (void)seq;
    (void)opcode;
    if (length == 2 * (J2A_TIME_BYTES + 1))
        printf("%u %u", payload[J2A_TIME_BYTES], payload[2 * J2A_TIME_BYTES + 1]);
    else
        printf("%u bytes", length);
}

static void turn(void) {
    transds_process();
    putchar('\n');
}

static void ask(void) {
    uint8_t room[J2A_ROOM] = {0, J2A_TRANSD_SAMPLE};
    uint8_t *payload = room;
    uint8_t length = 2;
    const uint8_t code = j2a_transd(&length, &payload);
    printf("%u %u\n", code, length);
}

int main(int argc, char **argv) {
    volatile uint8_t *const head = &j2a_transducers[0].sensor->head;
    if (argc != 4)
        return 1;
    transds_init();
    both(0, ++last);
    both(1, ++last);
    channel_of_interrupt = (uint8_t)atoi(argv[1]);
    every = atoi(argv[2]);
    blocks = 0;
    most = atoi(argv[3]);
    turn();
    turn();
    turn();
    most = came;
    turn();
    turn();
    both(0, 99);
    (*head)++; /* a driver that is interrupted within j2a_keep() */
    turn();
    ask();
    (*head)++;
    both(1, 100);
    ask();
    turn();
    turn();
    printf("%d\n", came);
    return 0;
}
