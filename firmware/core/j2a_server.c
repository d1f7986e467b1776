/* The server: takes bytes from the port to the parser, and each event of the parser to a reply.
 * Rules: what has been received is parsed before a timeout is judged; the opcode is judged only
 * here, so after the checksum; one reply for each frame, in order. */
#include "j2a_internal.h"

/* One more, because the first tick of a pause may be cut short. */
#define PAUSE_TICKS ((uint16_t)(J2A_PAUSE_MS * J2A_TICKS_PER_MS + 1))

void j2a_poll(void) {
    /* Read before the bytes are taken: only then does "no byte" mean that none came before now. */
    const uint16_t now_ticks = j2a_port_ticks();
    uint8_t turns = 255; /* bounded, so that endless noise does not keep the application waiting */
    int16_t byte;

    if (j2a_rx.fed) { /* since the last call; taking bytes may have lasted until now */
        j2a_rx.fed = false;
        j2a_rx.last_ticks = now_ticks;
    }
    while (turns-- && j2a_rx.event == J2A_EVENT_NONE && (byte = j2a_port_rx()) >= 0) {
        j2a_rx.fed = true;
        j2a_rx_parse((uint8_t)byte);
    }
    if (j2a_rx.event == J2A_EVENT_NONE && !j2a_rx.fed && j2a_rx_busy()
        && (uint16_t)(now_ticks - j2a_rx.last_ticks) >= PAUSE_TICKS)
        j2a_rx_timeout();
}

uint8_t j2a_error(uint8_t code, uint8_t site, uint8_t *length, uint8_t *payload) {
    payload[0] = site;
    payload[1] = 0;
    *length = 2;
    return code;
}

uint8_t j2a_find(uint8_t opcode, uint8_t kind, j2a_function *function) {
    const j2a_entry *entry;
    if (opcode >= j2a_flash_u8(&j2a_function_count))
        return J2A_SITE_OPCODE;
    entry = &j2a_functions[opcode];
    if (j2a_flash_u8(&entry->kind) != kind)
        return J2A_SITE_KIND;
    *function = j2a_flash_function(&entry->function);
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
static uint8_t execute(uint8_t *length, uint8_t **payload) {
    j2a_function function;
    const uint8_t site = j2a_find(j2a_rx.opcode, J2A_KIND_CALL, &function);
    uint8_t code;

    if (site != 0)
        return j2a_error(J2A_ERR_OPCODE, site, length, *payload);
#if J2A_ROOM < J2A_MAX_PAYLOAD
    if (*length > J2A_ROOM) {
        *length = 0;
        return J2A_RET_FAILED;
    }
#endif
    code = ((j2a_call_fn *)function)(length, payload);
    return code > J2A_RET_MAX && !may_refuse(function) ? J2A_RET_FAILED : code;
}

void j2a_process(void) {
    uint8_t code = j2a_rx.event;
    uint8_t length = j2a_rx.length;
    uint8_t *payload = j2a_rx.payload;

    if (code == J2A_EVENT_NONE)
        return;
    if (code == J2A_EVENT_FRAME)
        code = execute(&length, &payload);
    j2a_send(J2A_SOF, j2a_rx.seq, code, length, payload);
    j2a_rx.fed = true; /* bytes had to wait meanwhile: the pause is measured from now on */
    j2a_rx.event = J2A_EVENT_NONE;
}

void j2a_task(void) {
    uint8_t turns;
    for (turns = J2A_LINKS; turns != 0; turns--) {
        j2a_poll();
        j2a_process();
#if J2A_LINKS > 1
        j2a_link = (uint8_t)((j2a_link + 1) % J2A_LINKS);
#endif
    }
}
