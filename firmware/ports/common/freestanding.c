/* What GCC and Clang expect of every machine, also of one without a library: they call these by themselves,
 * to copy a struct for example. For ports whose compiler comes without a C library.
 * Rule: what is written to is volatile, because a compiler that sees a loop fill or copy bytes makes it a call of
 * memset() or memcpy(), which would then call themselves. */
#include <stddef.h>

void *memset(void *to, int value, size_t count);
void *memcpy(void *restrict to, const void *restrict from, size_t count);

void *memset(void *to, int value, size_t count) {
    volatile unsigned char *next = to;
    while (count--)
        *next++ = (unsigned char)value;
    return to;
}

void *memcpy(void *restrict to, const void *restrict from, size_t count) {
    volatile unsigned char *next = to;
    const unsigned char *source = from;
    while (count--)
        *next++ = *source++;
    return to;
}
