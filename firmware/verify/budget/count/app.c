/* Runs through what receiving and answering costs, once each and without interrupts, for a tool that counts
 * the instructions within the functions count_*:
 *   count_rx_plain, count_rx_escaped   an echo of J2A_ROOM bytes passes through j2a_rx_parse(), loop included
 *   count_call                         j2a_process() with an echo without payload
 *   count_tx_plain, count_tx_escaped   the same with the payloads of the first two
 * Out go the replies, and in the end a SIF with opcode 0xC0, after which nothing is counted any more. */
#include "j2a_internal.h"

#if defined __arm__
#define INTERRUPTS_OFF() __asm__ volatile("cpsid i" ::: "memory")
#define INTERRUPTS_ON() __asm__ volatile("cpsie i" ::: "memory")
#elif defined __riscv
#define INTERRUPTS_OFF() __asm__ volatile("csrci mstatus, 8" ::: "memory")
#define INTERRUPTS_ON() __asm__ volatile("csrsi mstatus, 8" ::: "memory")
#else
#define INTERRUPTS_OFF() ((void)0)
#define INTERRUPTS_ON() ((void)0)
#endif
/* The compiler must neither merge the functions nor move anything out of them. */
#define COUNTED __attribute__((noinline, used)) void
#define END_OF_COUNT(number) __asm__ volatile("" ::"i"(number) : "memory")

enum { ECHO = 1 + J2A_WITH_MANY + J2A_WITH_PROPERTIES + J2A_WITH_DEBUG, DONE = 0xC0 };

COUNTED count_rx_plain(void);
COUNTED count_rx_escaped(void);
COUNTED count_call(void);
COUNTED count_tx_plain(void);
COUNTED count_tx_escaped(void);

static uint8_t wire[2 * J2A_ROOM + 10];
static uint16_t wire_length;

void j2a_app_task(void) {
}

static void put(uint8_t byte) {
    if (byte == J2A_SOF || byte == J2A_SOS || byte == J2A_ESC) {
        wire[wire_length++] = J2A_ESC;
        byte--;
    }
    wire[wire_length++] = byte;
}

/* An echo of so many times the given value. */
static void build(uint8_t value, uint8_t length) {
    uint8_t checksum = (uint8_t)(ECHO + J2A_CHK_OPCODE) ^ (uint8_t)(length + J2A_CHK_LENGTH);
    uint8_t i;
    wire[0] = J2A_SOF;
    wire_length = 1;
    put(0);
    put(ECHO);
    put(length);
    for (i = 0; i != length; i++) {
        put(value);
        checksum ^= value;
    }
    put(checksum);
}

static inline void parse(void) {
    const uint8_t *byte = wire;
    uint16_t i;
    for (i = wire_length; i != 0; i--)
        j2a_rx_parse(*byte++);
}

COUNTED count_rx_plain(void) {
    parse();
    END_OF_COUNT(1);
}

COUNTED count_rx_escaped(void) {
    parse();
    END_OF_COUNT(2);
}

COUNTED count_call(void) {
    j2a_process();
    END_OF_COUNT(3);
}

COUNTED count_tx_plain(void) {
    j2a_process();
    END_OF_COUNT(4);
}

COUNTED count_tx_escaped(void) {
    j2a_process();
    END_OF_COUNT(5);
}

/* Where a count ends. */
COUNTED counted(void);
COUNTED counted(void) {
    END_OF_COUNT(6);
}

int main(int argc, char **argv) {
    j2a_port_init(argc, argv);
    INTERRUPTS_OFF();

    build(0, 0);
    parse();
    count_call();
    counted();
    build(0x55, J2A_ROOM);
    count_rx_plain();
    counted();
    count_tx_plain();
    counted();
    build(J2A_SOF, J2A_ROOM);
    count_rx_escaped();
    counted();
    count_tx_escaped();
    counted();

    INTERRUPTS_ON();
    j2a_send(J2A_SOS, 0, DONE, 0, wire);
    for (;;) {
        j2a_poll();
        j2a_process();
        j2a_port_idle();
    }
}
