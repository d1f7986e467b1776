/* Runs the golden vectors against the C parser and sender, on the host. In: j2a_vectors.h. Out: a
 * line for each vector that fails; the exit status. */
#include <stdio.h>
#include <string.h>

#include "j2a_internal.h"
#include "j2a_vectors.h"

static uint8_t sent[J2A_MAX_WIRE];
static size_t sent_length;

void j2a_port_tx(uint8_t byte) {
    if (sent_length < sizeof sent)
        sent[sent_length] = byte;
    sent_length++;
}

/* Compares what the parser makes of the bytes with the answers, one after the other (j2a_vectors.h). */
static int stream(const char *name, const uint8_t *bytes, size_t count, const uint8_t *answers,
                  size_t expected) {
    size_t at = 0;
    size_t i;
    int good = 1;

    memset(&j2a_rx, 0, sizeof j2a_rx);
    for (i = 0; i < count && good; i++) {
        const uint8_t *answer = answers + at;
        good = j2a_rx_byte(bytes[i]);
        if (j2a_rx.event == J2A_EVENT_NONE)
            continue;
        if (j2a_rx.event == J2A_EVENT_FRAME) {
            good = at < expected && answer[0] == 0 && answer[1] == j2a_rx.seq
                && answer[2] == j2a_rx.opcode && answer[3] == j2a_rx.length
                && memcmp(answer + 4, j2a_rx.payload, j2a_rx.length) == 0;
            at += 4u + j2a_rx.length;
        } else {
            good = at < expected && answer[0] == j2a_rx.event && answer[1] == j2a_rx.seq;
            at += 2;
        }
        good = good && !j2a_rx_byte(J2A_SOF); /* refused while the event waits */
        j2a_rx.event = J2A_EVENT_NONE;
    }
    if (good && at == expected)
        return 0;
    printf("%s: other events than expected, at byte %u\n", name, (unsigned)i);
    return 1;
}

static int encode(const char *name, const uint8_t *frame, const uint8_t *wire, size_t count) {
    sent_length = 0;
    j2a_send(frame[0], frame[1], frame[2], frame[3], frame + 4);
    if (sent_length == count && memcmp(sent, wire, count) == 0)
        return 0;
    printf("%s: sent other bytes than expected\n", name);
    return 1;
}

#define STREAM(name, count, bytes, expected, answers) \
    failed += stream(name, (const uint8_t *)bytes, count, (const uint8_t *)answers, expected); \
    ran++;
#define ENCODE(name, length, frame, count, wire) \
    failed += encode(name, (const uint8_t *)frame, (const uint8_t *)wire, count); \
    ran++;

int main(void) {
    int failed = 0;
    int ran = 0;
    J2A_STREAM_VECTORS(STREAM)
    J2A_ENCODE_VECTORS(ENCODE)
    printf("%d vectors, %d failed\n", ran, failed);
    return failed != 0;
}
