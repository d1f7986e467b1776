/* The demo: one function of each kind, and the tools that a conformance run asks for. Requests come
 * in as the functions' payloads (little-endian numbers); a wrong length returns J2A_RET_FAILED. */
#include "j2a_functions.h"

#if !J2A_WITH_CLOCK
#error "the demo tells the time: it needs J2A_WITH_CLOCK=1"
#endif

static uint16_t get_u16(const uint8_t *bytes) {
    return (uint16_t)(bytes[0] | (uint16_t)bytes[1] << 8);
}

static uint8_t failed(uint8_t *length) {
    *length = 0;
    return J2A_RET_FAILED;
}

/* Replies 8 bytes: microseconds since the start. */
uint8_t demo_get_time(uint8_t *const length, uint8_t **const payload) {
    const uint64_t now_us = j2a_port_time_us();
    j2a_put_u32(*payload, (uint32_t)now_us);
    j2a_put_u32(*payload + 4, (uint32_t)(now_us >> 32));
    *length = 8;
    return 0;
}

/* Takes two i32, replies their sum, which wraps. */
uint8_t demo_add(uint8_t *const length, uint8_t **const payload) {
    if (*length != 8)
        return failed(length);
    j2a_put_u32(*payload, j2a_get_u32(*payload) + j2a_get_u32(*payload + 4));
    *length = 4;
    return 0;
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

/* Takes u16 milliseconds and returns that much later. */
uint8_t demo_delay(uint8_t *const length, uint8_t **const payload) {
    const uint64_t start_us = j2a_port_time_us();
    uint32_t delay_us;

    if (*length != 2)
        return failed(length);
    delay_us = get_u16(*payload) * (uint32_t)1000;
    while (j2a_port_time_us() - start_us < delay_us) {
    }
    *length = 0;
    return 0;
}

/* Replies u16: receive overruns since the start. */
uint8_t demo_overruns(uint8_t *const length, uint8_t **const payload) {
    const uint16_t overruns = j2a_port_overruns();
    (*payload)[0] = (uint8_t)overruns;
    (*payload)[1] = (uint8_t)(overruns >> 8);
    *length = 2;
    return 0;
}

#if J2A_WITH_SIF

enum { SIF_PERIODIC = 0x20 };

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
    j2a_send_sif((*payload)[0], (uint8_t)(given - 1), *payload + 1);
    return 0;
}

/* Takes u16 milliseconds between SIFs that count from 0; 0 stops them. */
uint8_t demo_sif_period(uint8_t *const length, uint8_t **const payload) {
    if (*length != 2)
        return failed(length);
    timer.period_us = get_u16(*payload) * (uint32_t)1000;
    timer.next_us = (uint32_t)j2a_port_time_us() + timer.period_us;
    timer.counter = 0;
    *length = 0;
    return 0;
}

/* The lower 32 bits will do for differences of up to 65 s. */
static int32_t time_left_us(void) {
    return (int32_t)(timer.next_us - (uint32_t)j2a_port_time_us());
}

static void send_when_due(void) {
    uint8_t payload[4];
    if (timer.period_us == 0 || time_left_us() > 0)
        return;
    j2a_put_u32(payload, timer.counter++);
    j2a_send_sif(SIF_PERIODIC, sizeof payload, payload);
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

uint8_t demo_sif_period(uint8_t *const length, uint8_t **const payload) {
    (void)payload;
    return failed(length);
}

void j2a_app_task(void) {
}

#endif
