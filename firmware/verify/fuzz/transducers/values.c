/* See values.h. */
#include "values.h"

#include <math.h>
#include <string.h>

/* Of 8 bytes with or without a sign, and the difference of two. */
__extension__ typedef __int128 integer;

static integer whole(const described *d, const uint8_t *bytes) {
    integer number = 0;
    uint8_t i;
    for (i = d->size; i-- > 0;)
        number = number * 256 + bytes[i];
    if (d->form == 'i' && bytes[d->size - 1] > 0x7F)
        return number - ((integer)1 << 8 * d->size);
    return number;
}

/* The fuzzer runs on a little-endian machine only. */
static float single(const uint8_t *bytes) {
    float number;
    memcpy(&number, bytes, sizeof number);
    return number;
}

static double real(const described *d, const uint8_t *bytes) {
    double number;
    if (d->form == 'f')
        return (double)single(bytes);
    memcpy(&number, bytes, sizeof number);
    return number;
}

static bool is_float(const described *d) {
    return d->form == 'f' || d->form == 'd';
}

void value_put(const described *d, double value, uint8_t *bytes) {
    const float small = (float)value;
    const int64_t number = is_float(d) ? 0 : (int64_t)value;
    if (d->form == 'f')
        memcpy(bytes, &small, sizeof small);
    else if (d->form == 'd')
        memcpy(bytes, &value, sizeof value);
    else
        memcpy(bytes, &number, d->size < sizeof number ? d->size : sizeof number);
}

static bool is_na(const described *d, const uint8_t *bytes) {
    if (!d->has_na)
        return false;
    if (is_float(d))
        return isnan(d->na) ? isnan(real(d, bytes)) : real(d, bytes) == d->na;
    return whole(d, bytes) == (integer)d->na;
}

bool value_differs(const described *d, const uint8_t *a, const uint8_t *b, const uint8_t *limit) {
    if (is_na(d, a) != is_na(d, b))
        return true;
    if (is_float(d)) {
        const double x = real(d, a), y = real(d, b), least = real(d, limit);
        if (isnan(x) || isnan(y))
            return isnan(x) != isnan(y) || least <= 0;
        if (x == y)
            return least <= 0;
        /* In the precision of the type. */
        return d->form == 'f' ? fabsf(single(a) - single(b)) >= single(limit) : fabs(x - y) >= least;
    }
    const integer difference = whole(d, a) - whole(d, b);
    return (difference < 0 ? -difference : difference) >= whole(d, limit);
}

bool value_is_limit(const described *d, const uint8_t *bytes) {
    return is_float(d) ? real(d, bytes) >= 0 : whole(d, bytes) >= 0;
}

/* UTF-8 as the standard's table of code points has it. */
bool value_is_text(const uint8_t *bytes, size_t length) {
    while (length > 0) {
        const uint8_t first = *bytes;
        const size_t size =
            first < 0x80 ? 1 : first < 0xC0 || first > 0xF7 ? 0 : first < 0xE0 ? 2 : first < 0xF0 ? 3 : 4;
        const uint32_t lowest[] = {0, 0x20, 0x80, 0x800, 0x10000};
        uint32_t point = size < 2 ? first : first & (0x7Fu >> size);
        size_t i;
        if (size == 0 || size > length)
            return false;
        for (i = 1; i < size; i++) {
            if (bytes[i] >> 6 != 2)
                return false;
            point = point << 6 | (bytes[i] & 0x3F);
        }
        if (point < lowest[size] || point == 0x7F || point > 0x10FFFF || (point >= 0xD800 && point < 0xE000))
            return false;
        bytes += size;
        length -= size;
    }
    return true;
}

bool value_is_in_range(const described *d, const uint8_t *value) {
    if (!d->has_range)
        return true;
    if (is_float(d))
        return real(d, value) >= d->low && real(d, value) <= d->high;
    return whole(d, value) >= (integer)d->low && whole(d, value) <= (integer)d->high;
}
