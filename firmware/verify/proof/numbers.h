/* The contracts of the two functions that the others of j2a_numbers.h are made of. Each file that includes j2a.h has
 * those others, so each driver needs these, also where nothing calls them. */
#ifndef NUMBERS_H
#define NUMBERS_H

#include "j2a.h"

/*@ requires \valid_read(bytes + (0 .. 3)); */
uint32_t j2a_get_u32(const uint8_t *bytes);

/*@ requires \valid(bytes + (0 .. 3)); */
void j2a_put_u32(uint8_t *bytes, uint32_t value);

#endif
