/* Debug text: the application's text flows into a ring, the host takes it out with a2jDebug.
 * Rule: text that does not fit is dropped, by whole characters, and the host is told. */
#include "j2a_internal.h"

#if J2A_WITH_DEBUG

static char ring[J2A_DEBUGBUF];
static uint16_t first, used;
static bool lost;

void j2a_debug(const char *text) {
    uint16_t whole = used; /* up to the end of the last character */
    for (; *text; text++) {
        if ((*text & 0xC0) != 0x80)
            whole = used;
        if (used == J2A_DEBUGBUF) {
            used = whole;
            lost = true;
            return;
        }
        ring[(first + used) % J2A_DEBUGBUF] = *text;
        used++;
    }
}

uint8_t j2a_get_debug(uint8_t *const length, uint8_t **const payload) {
    uint8_t n = 0;
    uint8_t code = lost ? J2A_DEBUG_LOST : 0;
    lost = false;
    while (used != 0 && n < J2A_ROOM) {
        (*payload)[n++] = (uint8_t)ring[first];
        first = (uint16_t)((first + 1) % J2A_DEBUGBUF);
        used--;
    }
    if (used != 0)
        code |= J2A_DEBUG_MORE;
    *length = n;
    return code;
}

#endif
