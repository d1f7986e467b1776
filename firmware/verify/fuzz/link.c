/* A libFuzzer target: the whole core, on a link with time and losses, against a second opinion.
 * In: the bytes of the link; 0xA5 begins an event (see LLVMFuzzerTestOneInput()). Out: an abort where the core sends
 * anything but what is due. Rules: what is due is found here by other means than the core's: a frame
 * is collected whole and then judged, as the oracle of the specification does it. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "j2a_functions.h"
#include "j2a_internal.h"
#include "receiver.h"

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t count);

#define j2a_rx (*j2a_served())

enum {
    EVENT = 0xA5,
    QUEUE = 4096,
    OUTPUT = 1 << 16,
    ACCEPTED_TICKS = J2A_BYTE_TIMEOUT_MIN_MS * J2A_TICKS_PER_MS,
    ENDED_TICKS = J2A_BYTE_TIMEOUT_MAX_MS * J2A_TICKS_PER_MS
};

#define CHECK(condition) \
    do { \
        if (!(condition)) { \
            fprintf(stderr, "link.c:%d: not so: %s\n", __LINE__, #condition); \
            abort(); \
        } \
    } while (0)

/* ------------------------------------------------------------------- what is due, and what came */

static uint8_t due[OUTPUT], sent[OUTPUT];
static size_t due_length, sent_length;
static uint8_t sif_seq;

static void owe_byte(uint8_t byte) {
    CHECK(due_length + 2 <= sizeof due);
    if (byte == J2A_SOF || byte == J2A_SOS || byte == J2A_ESC) {
        due[due_length++] = J2A_ESC;
        byte--;
    }
    due[due_length++] = byte;
}

static void owe(uint8_t start, uint8_t seq, uint8_t opcode, uint8_t length, const uint8_t *payload) {
    uint8_t body[4 + J2A_MAX_PAYLOAD];
    size_t i;
    body[0] = seq;
    body[1] = opcode;
    body[2] = length;
    memcpy(body + 3, payload, length);
    body[3 + length] = receiver_sum(body);
    CHECK(due_length < sizeof due);
    due[due_length++] = start;
    for (i = 0; i < 4u + length; i++)
        owe_byte(body[i]);
}

static void owe_error(const receiver *frame, uint8_t code, uint8_t site) {
    const uint8_t payload[2] = {site, 0};
    if (frame->start == J2A_SOF && frame->length > 0)
        owe(J2A_SOF, frame->body[0], code, 2, payload);
}

void j2a_port_tx(uint8_t byte) {
    CHECK(sent_length < sizeof sent);
    sent[sent_length++] = byte;
}

/* ------------------------------------------------------------------------- the application --- */

/* What the functions do is in the request: return value, length of the reply, and how. */
static uint8_t elsewhere[J2A_MAX_PAYLOAD];
enum { POINT_ELSEWHERE = 1, SEND_SIF = 2, POINT_BEHIND = 4, OTHER_OFFSET = 8, FLIP_LAST = 16 };

/* No more than there is where it points. */
static uint8_t left_by_call(const uint8_t *p) {
    const uint8_t room = p[2] & POINT_ELSEWHERE ? J2A_MAX_PAYLOAD : J2A_ROOM;
    return p[1] < room ? p[1] : room;
}

uint8_t fuzz_call(uint8_t *const length, uint8_t **const payload) {
    const uint8_t *const p = *payload;
    const uint8_t code = p[0];
    const uint8_t how = p[2];
    if (*length < 3)
        return J2A_RET_FAILED;
    *length = left_by_call(p);
    if (how & SEND_SIF)
        j2a_send_sif(how, *length, elsewhere);
    if (how & POINT_ELSEWHERE)
        *payload = elsewhere;
    else if (how & POINT_BEHIND)
        *payload += J2A_ROOM - *length;
    return code;
}

uint8_t fuzz_many(bool *is_last, bool is_write, uint32_t *const offset, uint8_t *const length,
                  uint8_t **const data) {
    const uint8_t *const p = *data;
    const uint8_t code = p[0];
    const uint8_t how = p[2];
    if (*length < 3)
        return is_write ? 1 : J2A_RET_FAILED;
    *length = p[1];
    if (how & SEND_SIF)
        j2a_send_sif(how, *length, elsewhere);
    if (how & OTHER_OFFSET)
        *offset = ~*offset;
    if (how & FLIP_LAST)
        *is_last = !*is_last;
    if (how & POINT_ELSEWHERE)
        *data = elsewhere;
    return code;
}

static char text[2 * J2A_DEBUGBUF];
static size_t text_length;
static bool text_lost;

static void debug(uint8_t count) {
    char line[UINT8_MAX + 1];
    size_t i;
    memset(line, 'a' + count % 26, count);
    line[count] = 0;
    j2a_debug(line);
    for (i = 0; i < count && !text_lost; i++) {
        if (text_length == J2A_DEBUGBUF)
            text_lost = true;
        else
            text[text_length++] = line[i];
    }
}

/* -------------------------------------------------------------------- what a request deserves */

enum { GET_MAPPING, MANY, GET_PROPERTIES, GET_DEBUG, ECHO, ECHO_MANY, USER_CALL, USER_MANY, FUNCTIONS };

#if J2A_WITH_MAPPING
static const char map[] =
    "a2jGetMapping\0a2jMany\0a2jGetProperties\0a2jDebug\0a2jEcho\0a2jEchoMany\0call\0many";
#endif

static bool is_many(uint8_t opcode) {
    return opcode == GET_PROPERTIES || opcode == ECHO_MANY || opcode == USER_MANY;
}

static uint8_t judged(uint8_t code) {
    return code > J2A_RET_MAX ? J2A_RET_FAILED : code;
}

static void owe_many(uint8_t seq, const uint8_t *p, uint8_t length) {
    uint8_t reply[J2A_MAX_PAYLOAD] = {0};
    const uint8_t n = (uint8_t)(length - J2A_MANY_HEADER);
    uint8_t left = n;
    uint8_t code = J2A_ECHO_MANY;
    bool last = p[1] & J2A_FLAG_LAST;

    memcpy(reply, p, length);
    if (p[0] == GET_PROPERTIES) {
        const uint32_t offset = p[2] | p[3] << 8 | p[4] << 16 | (uint32_t)p[5] << 24;
        size_t size = 0;
        while (j2a_properties[size] || j2a_properties[size + 1])
            size++;
        size++; /* the NUL of the last value */
        left = 0;
        code = p[1] & J2A_FLAG_WRITE ? J2A_RET_FAILED : 0;
        if (code == 0) {
            const size_t rest = offset < size ? size - offset : 0;
            left = (uint8_t)(rest < J2A_ROOM_MANY ? rest : J2A_ROOM_MANY);
            last = left == rest;
            if (left)
                memcpy(reply + J2A_MANY_HEADER, j2a_properties + offset, left);
        }
    } else if (p[0] == USER_MANY && n < 3) {
        code = p[1] & J2A_FLAG_WRITE ? 1 : J2A_RET_FAILED;
    } else if (p[0] == USER_MANY) {
        const uint8_t how = p[8];
        code = judged(p[6]);
        left = p[7];
        if (how & SEND_SIF)
            owe(J2A_SOS, sif_seq++, how, left, elsewhere);
        if (left > J2A_ROOM_MANY) {
            left = 0;
            code = J2A_RET_FAILED;
        } else if (how & POINT_ELSEWHERE) {
            memcpy(reply + J2A_MANY_HEADER, elsewhere, left);
        } else {
            memcpy(reply + J2A_MANY_HEADER, j2a_rx.payload + J2A_MANY_HEADER, left);
        }
        if (how & OTHER_OFFSET) {
            uint8_t i;
            for (i = 2; i < J2A_MANY_HEADER; i++)
                reply[i] = (uint8_t)~p[i];
        }
        if (how & FLIP_LAST)
            last = !last;
    }
    reply[0] = code;
    reply[1] = last;
    owe(J2A_SOF, seq, 0, (uint8_t)(left + J2A_MANY_HEADER), reply);
}

static void owe_reply(const receiver *request) {
    const uint8_t seq = request->body[0];
    const uint8_t opcode = request->body[1];
    const uint8_t length = request->body[2];
    const uint8_t *const p = request->body + 3;
    const bool has_func = opcode == MANY && length >= J2A_MANY_HEADER && length <= J2A_ROOM;

    if (opcode >= FUNCTIONS || (has_func && p[0] >= FUNCTIONS)) {
        owe_error(request, J2A_ERR_OPCODE, J2A_SITE_OPCODE);
    } else if (opcode == GET_PROPERTIES) {
        owe(J2A_SOF, seq, J2A_RET_FAILED, 0, p);
    } else if (is_many(opcode) || (has_func && !is_many(p[0]))) {
        owe_error(request, J2A_ERR_OPCODE, J2A_SITE_KIND);
#if !J2A_WITH_MAPPING
    } else if (opcode == GET_MAPPING) {
        owe_error(request, J2A_ERR_OPCODE, J2A_SITE_OPCODE);
#endif
    } else if (length > J2A_ROOM) {
        owe(J2A_SOF, seq, J2A_RET_FAILED, 0, p);
#if J2A_WITH_MAPPING
    } else if (opcode == GET_MAPPING) {
        owe(J2A_SOF, seq, 0, sizeof map, (const uint8_t *)map);
#endif
    } else if (opcode == MANY && length < J2A_MANY_HEADER) {
        owe(J2A_SOF, seq, J2A_RET_FAILED, 0, p);
    } else if (opcode == MANY) {
        owe_many(seq, p, length);
    } else if (opcode == GET_DEBUG) {
        const uint8_t taken = (uint8_t)(text_length < J2A_ROOM ? text_length : J2A_ROOM);
        const uint8_t more = text_length > taken ? J2A_DEBUG_MORE : 0;
        owe(J2A_SOF, seq, (text_lost ? J2A_DEBUG_LOST : 0) | more, taken, (uint8_t *)text);
        text_length -= taken;
        memmove(text, text + taken, text_length);
        text_lost = false;
    } else if (opcode == ECHO) {
        owe(J2A_SOF, seq, J2A_ECHO, length, p);
    } else if (length < 3) {
        owe(J2A_SOF, seq, J2A_RET_FAILED, length, p);
    } else {
        const uint8_t *reply = j2a_rx.payload;
        const uint8_t left = left_by_call(p);
        if (p[2] & SEND_SIF)
            owe(J2A_SOS, sif_seq++, p[2], left, elsewhere);
        if (p[2] & POINT_ELSEWHERE)
            reply = elsewhere;
        else if (p[2] & POINT_BEHIND)
            reply += J2A_ROOM - left;
        owe(J2A_SOF, seq, judged(p[0]), left, reply);
    }
}

/* ---------------------------------------------------------------------------------- the link --- */

enum { LOST = 0x100 };
static uint16_t queue[QUEUE];
static size_t queue_next, queue_end;
static uint16_t ticks;
static uint32_t idle_ticks; /* since the last byte */
static receiver requests;

uint16_t j2a_port_ticks(void) {
    return ticks;
}

int16_t j2a_port_rx(void) {
    while (queue_next < queue_end && queue[queue_next] == LOST) {
        queue_next++;
        j2a_rx_lost();
    }
    return queue_next == queue_end ? -1 : (int16_t)queue[queue_next++];
}

/* Owes what the next entry of the queue deserves. */
static void judge(uint16_t entry) {
    receiver old;
    if (entry == LOST) {
        owe_error(requests.start ? &requests : &(receiver){0}, J2A_ERR_FRAMING, J2A_SITE_LOST);
        requests.start = 0;
        return;
    }
    switch (receiver_take(&requests, (uint8_t)entry, &old)) {
    case GOOD:
        if (old.start == J2A_SOF)
            owe_reply(&old);
        break;
    case MARKER:
        owe_error(&old, J2A_ERR_FRAMING, J2A_SITE_MARKER);
        break;
    case ESCAPE:
        owe_error(&old, J2A_ERR_FRAMING, J2A_SITE_ESCAPE);
        break;
    case CHECKSUM:
        owe_error(&old, J2A_ERR_CHECKSUM, J2A_SITE_CHECKSUM);
        break;
    }
}

static void compare(void) {
    CHECK(sent_length == due_length && memcmp(sent, due, due_length) == 0);
    sent_length = due_length = 0;
}

/* A turn of the main loop. What a request deserves is found before its function writes over it. */
static void turn(void) {
    size_t i = queue_next;
    j2a_poll();
    CHECK(sent_length == 0);
    for (; i < queue_next; i++, idle_ticks = 0)
        judge(queue[i]);
    if (requests.start && idle_ticks >= ENDED_TICKS) {
        owe_error(&requests, J2A_ERR_TIMEOUT, J2A_SITE_TIMEOUT);
        requests.start = 0;
    }
    j2a_process();
    compare();
}

static void run_until_idle(void) {
    unsigned turns = 0;
    while (queue_next < queue_end) {
        CHECK(turns++ <= 2 * QUEUE);
        turn();
    }
    queue_next = queue_end = 0;
    turn(); /* sees that nothing came, so that a pause begins */
}

/* A pause that every device accepts, or one that none does. */
static void pass_time(uint8_t pause_ticks) {
    uint32_t passed = pause_ticks;
    run_until_idle();
    if (idle_ticks + passed > ACCEPTED_TICKS && idle_ticks + passed < ENDED_TICKS)
        passed = ENDED_TICKS - idle_ticks;
    idle_ticks += passed;
    ticks = (uint16_t)(ticks + passed);
    turn();
}

/* Queues a good request, whose checksum a mutation would seldom hit. */
static void request(uint8_t seq, uint8_t opcode, uint8_t length, const uint8_t *payload) {
    size_t i;
    owe(J2A_SOF, seq, opcode, length, payload);
    for (i = 0; i < due_length; i++)
        queue[queue_end++] = due[i];
    due_length = 0;
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t count) {
    size_t i;
    for (i = 0; i < sizeof elsewhere; i++)
        elsewhere[i] = (uint8_t)(i * 7);
    memset(j2a_served(), 0, sizeof(j2a_rx_t));
    sif_seq = 0;
    memset(&requests, 0, sizeof requests);
    for (i = 0; i < count; i++) {
        /* Of an event what is not there is 0. */
        const uint8_t one = i + 1 < count ? bytes[i + 1] : 0;
        const uint8_t two = i + 2 < count ? bytes[i + 2] : 0;
        const uint8_t three = i + 3 < count ? bytes[i + 3] : 0;
        if (queue_end > QUEUE - J2A_MAX_WIRE)
            run_until_idle();
        if (bytes[i] != EVENT) {
            queue[queue_end++] = bytes[i];
            continue;
        }
        switch (one) {
        case 0:
            run_until_idle();
            break;
        case 1:
            queue[queue_end++] = LOST;
            break;
        case 2:
            pass_time(two);
            i++;
            break;
        case 3:
            owe(J2A_SOS, sif_seq++, two, three, elsewhere);
            j2a_send_sif(two, three, elsewhere);
            compare();
            i += 2;
            break;
        case 4:
            debug(two);
            i++;
            break;
        case 5:
            turn();
            break;
        case 6: {
            const size_t left = i + 4 < count ? count - i - 4 : 0;
            const uint8_t length = left < three ? (uint8_t)left : three;
            request((uint8_t)i, two, length, bytes + (length ? i + 4 : 0));
            i += 2u + length;
            break;
        }
        default:
            queue[queue_end++] = one;
        }
        i++;
    }
    run_until_idle();
    pass_time(UINT8_MAX);
    return 0;
}
