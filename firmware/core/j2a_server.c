/* The server: takes bytes from the port to the parser, and each event of the parser to a reply.
 * Rules: what has been received is parsed before a timeout is judged; the opcode is judged only
 * here, so after the checksum; one reply for each frame, in order. */
#include "j2a_internal.h"

/* One more, because the first tick of a pause may be cut short. */
#define PAUSE_TICKS ((uint16_t)(J2A_PAUSE_MS * J2A_TICKS_PER_MS + 1))

/* Bytes in one call of j2a_poll(): bounded, so that endless noise does not keep the application waiting. */
enum { MAX_BYTES_PER_POLL = 255 };

void j2a_poll(void) {
    j2a_rx_t *const rx = &j2a_rx_of[j2a_link];
    /* Read before the bytes are taken: only then does "no byte" mean that none came before now. */
    const uint16_t now_ticks = j2a_port_ticks();
    uint8_t left = MAX_BYTES_PER_POLL;
    int16_t byte;
#if J2A_WITH_SYNC
    static uint16_t turned_ticks;

    if ((uint16_t)(now_ticks - turned_ticks) >= J2A_TICKS_PER_MS) {
        turned_ticks = now_ticks;
        j2a_clock_turn();
    }
#endif
    for (; left != 0 && rx->event == J2A_EVENT_NONE && (byte = j2a_port_rx()) >= 0; left--)
        j2a_rx_parse((uint8_t)byte);
#if J2A_WITH_SYNC
    if (rx->event == J2A_EVENT_FRAME && left != MAX_BYTES_PER_POLL)
        j2a_received_us = j2a_port_time_us();
#endif
    if (left != MAX_BYTES_PER_POLL)
        rx->last_ticks = j2a_port_ticks(); /* anew, because taking the bytes took its time */
    else if (rx->event == J2A_EVENT_NONE && (uint16_t)(now_ticks - rx->last_ticks) >= PAUSE_TICKS)
        j2a_rx_timeout();
}

uint8_t j2a_error(uint8_t code, uint8_t site, uint8_t *length, uint8_t *payload) {
    payload[0] = site;
    payload[1] = 0;
    *length = 2;
    return code;
}

static J2A_NOINLINE const j2a_entry *of_two_tables(uint8_t opcode) {
    return opcode < J2A_BUILTIN_COUNT ? &j2a_builtins[opcode] : &j2a_functions[opcode - J2A_BUILTIN_COUNT];
}

/* Link-time optimisation knows the count: without functions of the application an index is all of this. */
const j2a_entry *j2a_entry_of(uint8_t opcode) {
    return j2a_function_count == J2A_BUILTIN_COUNT ? &j2a_builtins[opcode] : of_two_tables(opcode);
}

uint8_t j2a_find(uint8_t opcode, uint8_t kind, j2a_function *function) {
    const j2a_entry *entry;
    if (opcode >= j2a_function_count)
        return J2A_SITE_OPCODE;
    entry = j2a_entry_of(opcode);
#if J2A_WITH_MANY
    if (j2a_flash_u8(&entry->kind) != kind)
        return J2A_SITE_KIND;
#else
    (void)kind;
#endif
    *function = j2a_flash_function(&entry->function);
    if (!*function)
        return J2A_SITE_OPCODE;
    return 0;
}

/* a2jMany alone may answer with an error code of the protocol. */
static bool may_refuse(j2a_function function) {
#if J2A_WITH_MANY
    return function == (j2a_function)j2a_many;
#else
    (void)function;
    return false;
#endif
}

/* Calls the function that the frame asks for. Returns the code of the reply. */
static uint8_t execute(uint8_t opcode, uint8_t *length, uint8_t **payload) {
    j2a_function function;
    const uint8_t site = j2a_find(opcode, J2A_KIND_CALL, &function);
    uint8_t code;

#if J2A_WITH_TRANSDUCERS
    j2a_is_heard = true;
#endif
    if (site != 0) {
        code = j2a_error(J2A_ERR_OPCODE, site, length, *payload);
#if J2A_WITH_PROPERTIES
        if (opcode == J2A_PROPERTIES_OPCODE) { /* a host of 2014 asks so and gives up on an error */
            *length = 0;
            code = J2A_RET_FAILED;
        }
#endif
        return code;
    }
#if J2A_ROOM < J2A_MAX_PAYLOAD
    if (*length > J2A_ROOM) {
        *length = 0;
        return J2A_RET_FAILED;
    }
#endif
    code = ((j2a_call_fn *)function)(length, payload);
    if (code > J2A_RET_MAX && !may_refuse(function))
        code = J2A_RET_FAILED;
    return code;
}

void j2a_process(void) {
    j2a_rx_t *const rx = &j2a_rx_of[j2a_link];
    uint8_t code = rx->event;
    uint8_t *payload = rx->payload;

#if J2A_WITH_BOOT
    (void)j2a_greet();
#endif
    if (code == J2A_EVENT_NONE)
        return;
    if (code == J2A_EVENT_FRAME)
        code = execute(rx->opcode, &rx->length, &payload);
#if J2A_LINKS > 1
    j2a_link = (uint8_t)(rx - j2a_rx_of); /* a function may have sent on another one */
#endif
    j2a_send(J2A_SOF, rx->seq, code, rx->length, payload);
    rx->event = J2A_EVENT_NONE;
}

void j2a_task(void) {
#if J2A_LINKS > 1
    uint8_t links;
    for (links = J2A_LINKS; links != 0; links--) {
        j2a_poll();
        j2a_process();
        j2a_link = (uint8_t)((j2a_link + 1) % J2A_LINKS);
    }
#else
    j2a_poll();
    j2a_process();
#endif
}
