/* The server: takes bytes from the port to the parser, and each event of the parser to a reply.
 * Rules: what has been received is parsed before a timeout is judged; the opcode is judged only
 * here, so after the checksum; one reply for each frame, in order. */
#include "j2a_internal.h"

/* One more, because the first tick of a pause may be cut short. */
#define PAUSE_TICKS ((uint16_t)(J2A_PAUSE_MS * J2A_TICKS_PER_MS + 1))

void j2a_poll(void) {
    static uint16_t last_ticks;
    /* Read before the bytes are taken: only then does "no byte" mean that none came before now. */
    const uint16_t now_ticks = j2a_port_ticks();
    uint8_t turns = 255; /* bounded, so that endless noise does not keep the application waiting */
    int16_t byte;

    if (j2a_rx.fed) { /* since the last call; taking bytes may have lasted until now */
        j2a_rx.fed = false;
        last_ticks = now_ticks;
    }
    while (turns-- && j2a_rx.event == J2A_EVENT_NONE && (byte = j2a_port_rx()) >= 0)
        j2a_rx_byte((uint8_t)byte);
    if (j2a_rx.event == J2A_EVENT_NONE && !j2a_rx.fed && j2a_rx_busy()
        && (uint16_t)(now_ticks - last_ticks) >= PAUSE_TICKS)
        j2a_rx_timeout();
}

uint8_t j2a_find(uint8_t opcode, uint8_t kind, j2a_function *function) {
    const j2a_entry *entry;
    uint8_t found;
    if (opcode >= j2a_flash_u8(&j2a_function_count))
        return J2A_SITE_OPCODE;
    entry = &j2a_functions[opcode];
    found = j2a_flash_u8(&entry->kind);
    if (found != kind && !(kind == J2A_KIND_CALL && found == J2A_KIND_ROUTER))
        return J2A_SITE_KIND;
    *function = j2a_flash_function(&entry->function);
    return 0;
}

uint8_t j2a_error(uint8_t code, uint8_t site, uint8_t *length, uint8_t *payload) {
    payload[0] = site;
    payload[1] = 0;
    *length = 2;
    return code;
}

void j2a_process(void) {
    uint8_t code = j2a_rx.event;
    uint8_t error[2];
    uint8_t length = 0;
    uint8_t *payload = error;

    if (code == J2A_EVENT_NONE)
        return;
    if (code == J2A_EVENT_FRAME) {
        j2a_function function;
        uint8_t site = j2a_find(j2a_rx.opcode, J2A_KIND_CALL, &function);
        if (site == 0) {
            length = j2a_rx.length;
            payload = j2a_rx.payload;
            code = ((j2a_call_fn *)function)(&length, &payload);
            if (code > J2A_RET_MAX && function != (j2a_function)j2a_many)
                code = J2A_RET_FAILED;
        } else {
            code = j2a_error(J2A_ERR_OPCODE, site, &length, payload);
        }
    } else {
        j2a_error(code, j2a_rx.site, &length, payload);
    }
    j2a_send(J2A_SOF, j2a_rx.seq, code, length, payload);
    j2a_rx.fed = true; /* bytes had to wait meanwhile: the pause is measured from now on */
    j2a_rx.event = J2A_EVENT_NONE;
}

void j2a_task(void) {
    j2a_poll();
    j2a_process();
}
