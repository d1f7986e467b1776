/* The self-test: golden vectors flow from flash through this image's own parser and sender, out
 * comes the property j2a.selftest: "ok RUN/ALL DIGEST" or "failed RUN/ALL DIGEST NUMBER", NUMBER being
 * the first vector that failed, from 1 on, or 0 when the vectors are not read as they were compiled in.
 * It finds what no look at the source does: a compiler that is wrong, integers or chars of another
 * size or sign than expected, flash that is read at the wrong place.
 * Rule: runs before the link and the clock are set up, so it calls nothing of the port; the parser is as new when it
 * returns. */
#include "j2a_internal.h"

#if J2A_WITH_SELFTEST
#include "j2a_vectors.h"

#define BYTES(name, bytes) bytes
#if J2A_SELFTEST_SMALL
#define LARGE(X)
#define DIGEST J2A_VECTORS_SMALL_DIGEST
#else
#define LARGE(X) J2A_VECTORS_LARGE(X)
#define DIGEST J2A_VECTORS_DIGEST
#endif
static const unsigned char J2A_FLASH vectors[] = J2A_VECTORS_SMALL(BYTES) LARGE(BYTES);

#define KEY "j2a.selftest"
#define NOT_RUN KEY "\0failed 0/0 00000000 0"
static char property[sizeof KEY + sizeof "failed 65535/65535 01234567 65535"] = NOT_RUN;
static uint8_t property_used = sizeof NOT_RUN;

static const unsigned char *due; /* the bytes that the sender must send next */
static uint16_t due_count;
static bool sending, wrong;

void j2a_tx_byte(uint8_t byte) {
    if (!sending) {
        j2a_port_tx(byte);
    } else if (due_count == 0 || j2a_flash_u8(due) != byte) {
        wrong = true;
    } else {
        due++;
        due_count--;
    }
}

/* Not by memset(), so that the core needs no header of a library. */
static void reset_parser(void) {
    uint8_t *const bytes = (uint8_t *)j2a_served();
    size_t i;
    for (i = 0; i < sizeof(j2a_rx_t); i++)
        bytes[i] = 0;
}

/* Sends the frame that is in flash, and compares. */
static bool send(const unsigned char *frame, const unsigned char *wire, uint16_t count) {
    j2a_rx_t *const rx = j2a_served();
    const uint8_t length = j2a_flash_u8(frame + 3);
    uint8_t i;
    for (i = 0; i < length; i++)
        rx->payload[i] = j2a_flash_u8(frame + 4 + i);
    due = wire;
    due_count = count;
    wrong = false;
    sending = true;
    j2a_send(j2a_flash_u8(frame), j2a_flash_u8(frame + 1), j2a_flash_u8(frame + 2), length, rx->payload);
    sending = false;
    return !wrong && due_count == 0;
}

/* Compares the parser's event with what is due. Returns the bytes that it takes there, or 0. */
static uint16_t count_equal(const unsigned char *answer, uint16_t count) {
    j2a_rx_t *const rx = j2a_served();
    uint8_t i;
    if (count < 2 || j2a_flash_u8(answer + 1) != rx->seq)
        return 0;
    if (rx->event != J2A_EVENT_FRAME)
        return j2a_flash_u8(answer) == rx->event ? 2 : 0;
    if ((j2a_flash_u8(answer) != 0 && j2a_flash_u8(answer) != J2A_SOF) || count < 4u + rx->length
        || j2a_flash_u8(answer + 2) != rx->opcode || j2a_flash_u8(answer + 3) != rx->length)
        return 0;
    for (i = 0; i < rx->length; i++)
        if (j2a_flash_u8(answer + 4 + i) != rx->payload[i])
            return 0;
    return (uint16_t)(4 + rx->length);
}

/* Parses the bytes on the wire, and compares each event. */
static bool parse(const unsigned char *wire, uint16_t count, const unsigned char *answers, uint16_t left) {
    j2a_rx_t *const rx = j2a_served();
    reset_parser();
    for (; count--; wire++) {
        uint16_t taken;
        j2a_rx_parse(j2a_flash_u8(wire)); /* j2a_rx_byte() would read the clock */
        if (rx->event == J2A_EVENT_NONE)
            continue;
        taken = count_equal(answers, left);
        if (taken == 0 || j2a_rx_byte(J2A_SOF)) /* refused while the event waits */
            return false;
        answers += taken;
        left = (uint16_t)(left - taken);
        rx->event = J2A_EVENT_NONE;
    }
    return left == 0;
}

static void put_number(char before, uint16_t number) {
    uint16_t unit = 10000;
    property[property_used++] = before;
    while (unit > 1 && number < unit)
        unit /= 10;
    for (; unit != 0; unit /= 10)
        property[property_used++] = (char)('0' + number / unit % 10);
}

static void put_result(uint16_t ran, uint32_t digest, bool good, uint16_t failed) {
    const char *word = good ? "ok" : "failed";
    uint8_t i;
    for (property_used = sizeof KEY; *word; word++)
        property[property_used++] = *word;
    put_number(' ', ran);
    put_number('/', J2A_VECTORS_COUNT);
    property[property_used++] = ' ';
    for (i = 0; i < 8; i++, digest <<= 4) {
        const uint8_t digit = (uint8_t)(digest >> 28);
        property[property_used++] = (char)(digit < 10 ? '0' + digit : 'a' + digit - 10);
    }
    if (!good)
        put_number(' ', failed);
    property[property_used++] = '\0';
}

static uint16_t get_u16(const unsigned char *bytes) {
    return (uint16_t)(j2a_flash_u8(bytes) | (uint16_t)j2a_flash_u8(bytes + 1) << 8);
}

void j2a_selftest(void) {
    const unsigned char *const end = vectors + sizeof vectors - 1;
    const unsigned char *next;
    uint32_t digest = 0x811C9DC5;
    uint16_t ran = 0;
    uint16_t failed = 0;

    for (next = vectors; next != end; next++)
        digest = (digest ^ j2a_flash_u8(next)) * 0x01000193;
    /* Lengths that are read wrongly would lead anywhere. */
    for (next = vectors; digest == DIGEST && next != end;) {
        const uint16_t wire_count = get_u16(next);
        const uint16_t answer_count = get_u16(next + 2);
        const unsigned char *const wire = next + 4;
        const unsigned char *const answers = wire + wire_count;
        const uint8_t first = j2a_flash_u8(answers); /* of the next vector, when none is due */
        const bool is_frame = answer_count != 0 && (first == J2A_SOF || first == J2A_SOS);
        bool good = parse(wire, wire_count, answers, is_frame && first == J2A_SOS ? 0 : answer_count);
        if (is_frame && !send(answers, wire, wire_count))
            good = false;
        ran++;
        if (!good && failed == 0)
            failed = ran;
        next = answers + answer_count;
    }
    put_result(ran, digest, digest == DIGEST && failed == 0, failed);
    reset_parser();
}

void j2a_selftest_property(size_t at, uint32_t offset, bool *is_last, uint8_t *length, uint8_t *data) {
    j2a_append(property, property_used, at, offset, is_last, length, data);
}

#endif
