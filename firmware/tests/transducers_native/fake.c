/* A port without hardware for transducers: whoever loads it sets the time, gives requests and takes what was sent.
 * A read of the clock and a byte on the link may take their time, and a link that nobody reads lets the port wait. Rule: fake_log holds what drivers of actuators and triggers were told, and when by fake_us, in order. */
#include "j2a_clock.h"
#include "j2a_port.h"
#include "transds.h"

enum { LINK_BYTES = 1024, ENTRIES = 64 };

uint64_t fake_us;
bool fake_is_up = true;
uint32_t fake_read_us, fake_byte_us;
uint32_t fake_block_ms;  /* for so long the next byte is not taken */
uint32_t fake_driver_ms; /* for so long a driver waits within each function */
uint8_t fake_input[LINK_BYTES], fake_sent[LINK_BYTES];
uint32_t fake_input_length, fake_sent_length;
struct {
    uint64_t at_us;
    int32_t value;
} fake_log[ENTRIES];
uint32_t fake_log_length;

void fake_begin(void);
void fake_turn(void);
void fake_sense(uint8_t transducer, uint16_t value);

static uint32_t input_next;

int16_t j2a_port_rx(void) {
    return input_next == fake_input_length ? -1 : (int16_t)fake_input[input_next++];
}

static void wait_ms(uint32_t ms) {
    for (; ms != 0; ms--) {
        fake_us += 1000;
        j2a_waiting();
    }
}

void j2a_port_tx(uint8_t byte) {
    const uint32_t block_ms = fake_block_ms;
    fake_block_ms = 0;
    wait_ms(block_ms);
    fake_us += fake_byte_us;
    if (fake_sent_length < LINK_BYTES)
        fake_sent[fake_sent_length++] = byte;
}

uint16_t j2a_port_ticks(void) {
    return (uint16_t)(fake_us / 1000);
}

uint64_t j2a_port_time_us(void) {
    fake_us += fake_read_us;
    return fake_us;
}

#if J2A_WITH_SYNC
void j2a_port_wait(uint32_t local_us) {
    const int32_t left_us = (int32_t)(local_us - (uint32_t)fake_us);
    if (left_us > 0)
        fake_us += (uint32_t)left_us;
}
#endif

static void note(int32_t value) {
    if (fake_log_length < ENTRIES) {
        fake_log[fake_log_length].at_us = fake_us;
        fake_log[fake_log_length++].value = value;
    }
    wait_ms(fake_driver_ms);
}

enum { NEWEST, QUEUED, SECOND = 3, SENSORS };

static void (*callbacks[SENSORS])(uint8_t channel, uint16_t value);

void newest_set_cb(void (*callback)(uint8_t channel, uint16_t value)) {
    callbacks[NEWEST] = callback;
}

void queued_set_cb(void (*callback)(uint8_t channel, uint16_t value)) {
    callbacks[QUEUED] = callback;
}

void second_set_cb(void (*callback)(uint8_t channel, uint16_t value)) {
    callbacks[SECOND] = callback;
}

/* Measures at once. */
void newest_trigger(void) {
    note(-1);
    callbacks[NEWEST](0, 0xABCD);
}

void second_trigger(void) {
    note(-1);
    callbacks[SECOND](0, 0xABCD);
}

void servo_set(uint8_t channel, uint16_t value) {
    (void)channel;
    note(value);
}

void pair_set(uint8_t channel, uint16_t value) {
    (void)channel;
    note(value);
}

void fake_begin(void) {
    transds_init();
}

/* One turn of the main loop, with all of the input. */
void fake_turn(void) {
    do
        j2a_task();
    while (input_next != fake_input_length);
    input_next = fake_input_length = 0;
    transds_process();
}

/* Lets a driver give a value. */
void fake_sense(uint8_t transducer, uint16_t value) {
    callbacks[transducer](0, value);
}
