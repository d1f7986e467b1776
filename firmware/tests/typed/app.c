/* A function of each type, result and flag: each returns what it takes, or something simple made of it. */
#include "j2a_functions.h"

/* What several functions leave, to be small enough for an AVR. */
static uint16_t numbers[128];
static uint8_t bytes[255];

void app_nothing(void) {
}

int32_t app_add(int32_t a, int32_t b) {
    return (int32_t)((uint32_t)a + (uint32_t)b);
}

bool app_invert(bool on) {
    return !on;
}

uint8_t app_u8s(uint8_t v) {
    return v;
}

uint16_t app_u16s(uint16_t v) {
    return v;
}

uint32_t app_u32s(uint32_t v) {
    return v;
}

uint64_t app_u64s(uint64_t v) {
    return v;
}

int8_t app_i8s(int8_t v) {
    return v;
}

int16_t app_i16s(int16_t v) {
    return v;
}

int64_t app_i64s(int64_t v) {
    return v;
}

float app_f32s(float v) {
    return v;
}

#ifndef TYPED_NO_F64
double app_f64s(double v) {
    return v;
}
#endif

mode app_modes(mode mode) {
    return mode == mode_fast ? mode_fast : mode;
}

level app_levels(level v) {
    return v == level_low ? level_low : v;
}

point app_mirror(const point *p) {
    point mirrored;
    mirrored.x = p->y;
    mirrored.y = p->x;
    return mirrored;
}

void app_shapes(const shape *s, shape *copy, uint8_t *size) {
    *copy = *s;
    *size = j2a_size_shape;
}

void app_reverse(const int16_t v[3], int16_t reversed[3]) {
    uint8_t i;
    for (i = 0; i < 3; i++)
        reversed[i] = v[2 - i];
}

void app_points(const point p[2], point swapped[2]) {
    swapped[0] = p[1];
    swapped[1] = p[0];
}

int32_t app_sum(uint8_t scale, const int32_t *v, uint8_t count) {
    uint32_t sum = 0;
    while (count--)
        sum += (uint32_t)v[count];
    return (int32_t)(sum * scale);
}

void app_range(uint16_t from, uint8_t count, uint16_t **values, uint8_t *length) {
    uint8_t i;
    for (i = 0; i < count && i < 128; i++)
        numbers[i] = (uint16_t)(from + i);
    *values = numbers;
    *length = count;
}

void app_echo(const char *words, uint8_t length, char **result, uint8_t *result_length) {
    *result = (char *)words;
    *result_length = length;
}

/* Writes into the room that it is given. */
void app_greet(const char *name, uint8_t length, char **text, uint8_t *text_length) {
    uint8_t n = 0;
    uint8_t i;
    if (*text_length < length + 2) {
        j2a_fail(7);
        return;
    }
    (*text)[n++] = 'H';
    (*text)[n++] = 'i';
    (*text)[n++] = ' ';
    for (i = 0; i < length; i++)
        (*text)[n++] = name[i];
    *text_length = n;
}

void app_split(const uint8_t *data, uint8_t length, uint8_t *count, uint16_t *sum, uint8_t **copy,
               uint8_t *copy_length) {
    uint8_t i;
    *count = length;
    for (i = 0; i < length; i++)
        *sum = (uint16_t)(*sum + data[i]);
    *copy = (uint8_t *)data; /* is moved by the three bytes before it */
    *copy_length = length;
}

void app_flip(const uint8_t *data, uint8_t length, uint8_t **flipped, uint8_t *flipped_length) {
    uint8_t i;
    for (i = 0; i < length; i++)
        bytes[i] = (uint8_t)~data[i];
    *flipped = bytes;
    *flipped_length = length;
}

void app_bools(const bool *v, uint8_t length, bool first[3]) {
    uint8_t i;
    for (i = 0; i < length && i < 3; i++)
        first[i] = v[i];
}

void app_limited(uint8_t count, uint8_t **bytes, uint8_t *length) {
    uint8_t i;
    for (i = 0; i < count && i < *length; i++)
        (*bytes)[i] = i;
    *length = count;
}

void app_eight(int8_t a, uint8_t b, int16_t c, uint16_t d, int32_t e, uint32_t f, float g, bool h, int8_t *out_a,
               uint8_t *out_b, int16_t *out_c, uint16_t *out_d, int32_t *out_e, uint32_t *out_f, float *out_g,
               bool *out_h) {
    *out_a = a;
    *out_b = b;
    *out_c = c;
    *out_d = d;
    *out_e = e;
    *out_f = f;
    *out_g = g;
    *out_h = h;
}

int32_t app_failing(uint8_t code) {
    return j2a_fail(code);
}

void app_failText(uint8_t code, char **text, uint8_t *length) {
    *text = 0;
    *length = 200;
    j2a_fail(code);
}

static bool all_sent;

void app_sendAll(uint32_t n) {
    static const point at = {1.5F, -2.0F};
    static const int16_t raw[2] = {-1, 258};
    int16_t *const samples = (int16_t *)numbers;
    const uint8_t count = (uint8_t)n;
    uint8_t i;
    for (i = 0; i < 128; i++)
        samples[i] = (int16_t)(i - 3);
    for (i = 0; i < 5; i++)
        bytes[i] = (uint8_t)"words"[i];
    all_sent = j2a_sif_counter(n);
    all_sent = j2a_sif_place(&at, raw, level_low) && all_sent;
    all_sent = j2a_sif_note(9, (const char *)bytes, count) && all_sent;
    all_sent = j2a_sif_samples(samples, count) && all_sent;
    all_sent = j2a_sif_alarm() && all_sent;
    if (!all_sent)
        j2a_fail(2);
}

uint8_t typed_raw(uint8_t *const length, uint8_t **const payload) {
    (void)length;
    (void)payload;
    return 0x17;
}

uint8_t typed_raw_many(bool *is_last, bool is_write, uint32_t *const offset, uint8_t *const length,
                       uint8_t **const data) {
    (void)is_last;
    (void)is_write;
    (void)offset;
    (void)length;
    (void)data;
    return 0;
}

void j2a_app_task(void) {
    if (app_wave[3] == 0)
        app_wave[3] = 258;
}
