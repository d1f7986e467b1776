/* Arrays that grow. */
#ifndef J2A_SIM_GROWING_ARRAY_H
#define J2A_SIM_GROWING_ARRAY_H

#include <stdint.h>
#include <stdlib.h>

/* Returns the array with room for one item more. */
static inline void *grow_array(void *items, uint32_t count, uint32_t *size, size_t item)
{
    if (count < *size)
        return items;
    *size = *size ? 2 * *size : 256;
    items = realloc(items, *size * item);
    if (!items)
        abort(); /* a simulation that silently lost something would be worse */
    return items;
}

#endif
