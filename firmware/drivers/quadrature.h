/* Decodes quadrature signals, 4 counts in a period. In: the levels of both channels before and now,
 * A in bit 0 and B in bit 1. Out: the step that this is.
 * Forward is A before B: 0, 1, 3, 2, 0. When both channels have changed a state was missed, and nobody
 * knows which way it went: that is no step, but QUADRATURE_ILLEGAL. */
#ifndef QUADRATURE_H
#define QUADRATURE_H

#include <stdint.h>

#include "j2a_progmem.h"

enum { QUADRATURE_ILLEGAL = 2 };

extern const int8_t J2A_FLASH quadrature_steps[16];

/* Returns 1, -1, 0 or QUADRATURE_ILLEGAL. In the header, because an interrupt should not call. */
static inline int8_t quadrature_step(uint8_t before, uint8_t now) {
    uint8_t index = before;
    index += index; /* avr-gcc would multiply by 4 */
    index += index;
    return (int8_t)j2a_flash_u8(&quadrature_steps[(uint8_t)(index | now)]);
}

#endif
