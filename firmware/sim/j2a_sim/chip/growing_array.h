/* An array that grows: room for one item more. */
#ifndef J2A_SIM_GROWN_H
#define J2A_SIM_GROWN_H

#include <stdint.h>
#include <stdlib.h>

static inline void *grown(void *items, uint32_t count, uint32_t *size, size_t item)
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
