/* Values of which nothing is known: Eva takes each read of a volatile object as any value of its
 * type. The core itself is read without the word volatile (see prove.py). */
#ifndef ANY_H
#define ANY_H

#include "j2a_internal.h"

#undef volatile
extern volatile uint8_t any_u8;
extern volatile uint16_t any_u16;
extern volatile uint32_t any_u32;
#define any_bool ((any_u8 & 1u) != 0)

#endif
