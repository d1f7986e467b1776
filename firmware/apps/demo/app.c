/* The demo: typed functions, raw ones that read their payloads themselves, and the tools that a conformance run
 * asks for. */
#include "j2a_functions.h"

#if !J2A_WITH_CLOCK
#error "the demo tells the time: it needs J2A_WITH_CLOCK=1"
#endif

static uint8_t failed(uint8_t *length) {
    *length = 0;
    return J2A_RET_FAILED;
}

uint64_t app_getTime(void) {
    return j2a_port_time_us();
}

/* The sum wraps. */
int32_t app_add(int32_t a, int32_t b) {
    return (int32_t)((uint32_t)a + (uint32_t)b);
}

/* Keeps what was written last, for each link. A write at offset 0 starts anew; the next ones follow on. */
uint8_t demo_store(bool *is_last, bool is_write, uint32_t *const offset, uint8_t *const length,
                   uint8_t **const data) {
    static uint8_t contents[J2A_LINKS][DEMO_STORE_BYTES];
    static uint32_t sizes[J2A_LINKS];
    uint8_t *const content = contents[j2a_link];
    uint32_t size = sizes[j2a_link];
    uint32_t left;

    if (is_write) {
        uint8_t i;
        if (*offset == 0)
            size = sizes[j2a_link] = 0;
        if (*offset != size || *length > DEMO_STORE_BYTES - size)
            return failed(length);
        for (i = 0; i < *length; i++)
            content[size++] = (*data)[i];
        sizes[j2a_link] = size;
        *length = 0;
        return 0;
    }
    left = *offset < size ? size - *offset : 0;
    *is_last = left <= J2A_ROOM_MANY;
    *length = (uint8_t)(*is_last ? left : J2A_ROOM_MANY);
    if (left)
        *data = content + *offset;
    return 0;
}

/* Returns the first byte of its payload, and says so in the debug text. */
uint8_t demo_ret(uint8_t *const length, uint8_t **const payload) {
    static const char hex[] = "0123456789ABCDEF";
    char line[] = "ret 0x00\n";
    const uint8_t code = (*payload)[0];

    if (*length == 0)
        return J2A_RET_FAILED;
    line[6] = hex[code >> 4];
    line[7] = hex[code & 15];
    j2a_debug(line);
    *length = 0;
    return code;
}

void app_delay(uint16_t time_ms) {
    const uint64_t start_us = j2a_port_time_us();
    const uint32_t time_us = time_ms * (uint32_t)1000;
    while (j2a_port_time_us() - start_us < time_us) {
    }
}

uint16_t app_overruns(void) {
    return j2a_port_overruns();
}

int32_t app_divide(int32_t a, int32_t b) {
    if (b == 0)
        return j2a_fail(1);
    return b == -1 ? (int32_t)(0 - (uint32_t)a) : a / b; /* the quotient wraps, where it does not fit */
}

void app_echoNumbers(bool flag, int8_t small, uint16_t wide, int32_t sum, uint64_t big, bool on, bool *on_out,
                     int64_t *big_out, int64_t *sum_out, uint32_t *wide_out, int16_t *small_out,
                     uint8_t *flag_out) {
    *on_out = on;
    *big_out = (int64_t)big;
    *sum_out = sum;
    *wide_out = wide;
    *small_out = (int16_t)small;
    *flag_out = flag;
}

void app_echoShapes(mode chosen, const point *place, const int16_t raw[3], const char *note, uint8_t note_length,
                    int32_t raw_out[3], point *place_out, int8_t *mode_out, char **note_out,
                    uint8_t *note_out_length) {
    uint8_t i;
    for (i = 0; i < 3; i++)
        raw_out[i] = raw[i];
    *place_out = *place;
    *mode_out = (int8_t)chosen;
    *note_out = (char *)note;
    *note_out_length = note_length;
}

void app_echoWords(const uint16_t *words, uint8_t words_count, uint16_t **words_out, uint8_t *words_out_count) {
    *words_out = (uint16_t *)words;
    *words_out_count = words_count;
}

void app_echoFirst(uint32_t first, const uint8_t *rest, uint8_t rest_length, uint32_t *first_out) {
    (void)rest;
    (void)rest_length;
    *first_out = first;
}

#if J2A_WITH_SIF

/* Of the SIFs that each link is sent. */
static struct {
    uint32_t period_us, next_us, counter;
} timers[J2A_LINKS];
#define timer (timers[j2a_link])

/* Takes an opcode and a payload, and sends them as a SIF before it returns. */
uint8_t demo_sif(uint8_t *const length, uint8_t **const payload) {
    const uint8_t given = *length;
    *length = 0;
    if (given == 0)
        return J2A_RET_FAILED;
#if J2A_WITH_BOOT
    if ((*payload)[0] == J2A_BOOT)
        return J2A_RET_FAILED;
#endif
    j2a_send_sif((*payload)[0], (uint8_t)(given - 1), *payload + 1);
    return 0;
}

/* Starts the count anew. */
void app_sifPeriod(uint16_t period_ms) {
    timer.period_us = period_ms * (uint32_t)1000;
    timer.next_us = (uint32_t)j2a_port_time_us() + timer.period_us;
    timer.counter = 0;
}

/* The lower 32 bits will do for differences of up to 65 s. */
static int32_t time_left_us(void) {
    return (int32_t)(timer.next_us - (uint32_t)j2a_port_time_us());
}

static void send_when_due(void) {
    if (timer.period_us == 0 || time_left_us() > 0)
        return;
    j2a_sif_counter(timer.counter++);
    timer.next_us += timer.period_us;
    if (time_left_us() < 0) /* too slow for this period: what was missed is left out */
        timer.next_us = (uint32_t)j2a_port_time_us() + timer.period_us;
}

void j2a_app_task(void) {
#if J2A_LINKS > 1
    for (j2a_link = J2A_LINKS - 1; j2a_link != 0; j2a_link--) /* and at last 0, as it was */
        send_when_due();
#endif
    send_when_due();
}

#else /* the opcodes stay, and fail */

uint8_t demo_sif(uint8_t *const length, uint8_t **const payload) {
    (void)payload;
    return failed(length);
}

void app_sifPeriod(uint16_t period_ms) {
    (void)period_ms;
    j2a_fail(J2A_RET_FAILED);
}

void j2a_app_task(void) {
}

#endif
