/* Functions of kind many: called for each chunk, which is where offset says.
 * Rule: what is kept between two chunks is kept for each link, because another host may be in between. */
#include "flow.h"

enum { NOTES_BYTES = 300 };

static uint8_t failed(uint8_t *length) {
    *length = 0;
    return J2A_RET_FAILED;
}

/* Gives the chunk at *offset of some bytes that stay where they are. */
static uint8_t give(uint8_t *bytes, uint16_t size, bool *is_last, const uint32_t *offset, uint8_t *length,
                    uint8_t **data) {
    const uint16_t left = *offset < size ? (uint16_t)(size - *offset) : 0;
    *is_last = left <= J2A_ROOM_MANY;
    *length = (uint8_t)(*is_last ? left : J2A_ROOM_MANY);
    if (left != 0)
        *data = bytes + *offset;
    return J2A_RET_OK;
}

/* Keeps a text of up to NOTES_BYTES. One that does not arrive as a whole is not kept. */
uint8_t flow_notes(bool *is_last, bool is_write, uint32_t *const offset, uint8_t *const length,
                   uint8_t **const data) {
    static uint8_t notes[NOTES_BYTES], arriving[J2A_LINKS][NOTES_BYTES];
    static uint16_t notes_size, arrived[J2A_LINKS];
    uint8_t i;

    if (!is_write)
        return give(notes, notes_size, is_last, offset, length, data);
    if (*offset == 0)
        arrived[j2a_link] = 0; /* whatever came before */
    if (*offset != arrived[j2a_link] || *length > NOTES_BYTES - arrived[j2a_link])
        return failed(length);
    for (i = 0; i < *length; i++)
        arriving[j2a_link][arrived[j2a_link]++] = (*data)[i];
    if (*is_last) {
        for (notes_size = 0; notes_size < arrived[j2a_link]; notes_size++)
            notes[notes_size] = arriving[j2a_link][notes_size];
    }
    *length = 0;
    return J2A_RET_OK;
}

/* Gives the log as it was when the first chunk was asked for, while the main loop goes on logging. */
uint8_t flow_log(bool *is_last, bool is_write, uint32_t *const offset, uint8_t *const length,
                 uint8_t **const data) {
    static uint8_t copies[J2A_LINKS][2 * LOG_SAMPLES];
    static uint16_t sizes[J2A_LINKS];

    if (is_write)
        return failed(length);
    if (*offset == 0)
        sizes[j2a_link] = log_copy(copies[j2a_link]);
    return give(copies[j2a_link], sizes[j2a_link], is_last, offset, length, data);
}
