/* The functions that j2a_table.c makes of typed entries: called with requests of every length and arbitrary bytes, for
 * functions that leave whatever they may, and fail at times. */
#include "any.h"
#include "numbers.h"

#include "j2a_table.c" /* its functions are static */

volatile uint8_t any_u8;
volatile uint16_t any_u16;
volatile uint32_t any_u32;

#include "any_numbers.h"

j2a_rx_t j2a_rx_of[J2A_LINKS];

static uint8_t elsewhere[J2A_MAX_PAYLOAD];

/* ------------------------------------------------------------------------- the core's model ------ */

void j2a_send_sif(uint8_t opcode, uint8_t length, const uint8_t *payload) {
    (void)opcode;
    //@ check length == 0 || \valid_read(payload + (0 .. length - 1));
    (void)length;
    (void)payload;
}

/* ------------------------------------------------------------------------- the application ------ */

/* Where a function leaves what is open: elsewhere, in the request, or in the room behind that. */
static uint8_t place;

/* Reads every byte that it is given. */
static void read_all(const uint8_t *bytes, uint8_t count) {
    //@ check count == 0 || \valid_read(bytes + (0 .. count - 1));
    (void)bytes;
    (void)count;
}

/* Leaves as many bytes as there are, or fewer, and fails at times. */
static void leave(const uint8_t *given, uint8_t length, uint8_t **bytes, uint8_t *count) {
    uint8_t left = any_u8;
    //@ check *count == 0 || \valid(*bytes + (0 .. *count - 1));
    if (place == 0) {
        *bytes = elsewhere;
    } else {
        if (place == 1) {
            *bytes = (uint8_t *)given;
            *count = length;
        }
        if (left > *count)
            left = *count;
    }
    *count = left;
    if (any_bool)
        j2a_fail(any_u8);
}

void app_all(const point *p, const int16_t v[3], bool on, const uint8_t *data, uint8_t length, uint8_t *a, point b[2],
             uint8_t **c, uint8_t *c_length) {
    read_all(data, length);
    *a = (uint8_t)((uint8_t)v[2] + on);
    b[1] = *p;
    leave(data, length, c, c_length);
}

void app_numbers(float a, int64_t b, uint64_t c, int8_t d, int32_t e, uint32_t f, float *out_a, int64_t *out_b,
                 uint64_t *out_c, int8_t *out_d, bool *out_e) {
    *out_a = a;
    *out_b = b;
    *out_c = c;
    *out_d = d;
    *out_e = e > 0 && f != 0;
}

double app_ratio(double r) {
    return r;
}

void app_nothing(void) {
}

void app_list(uint8_t a, const uint16_t *v, uint8_t length, uint32_t **values, uint8_t *count) {
    static uint32_t numbers[J2A_MAX_PAYLOAD];
    numbers[a % J2A_MAX_PAYLOAD] = length != 0 ? v[length - 1] : any_u32;
    *values = numbers;
    *count = any_u8;
    if (any_bool)
        j2a_fail(any_u8);
}

int32_t app_code(uint16_t code) {
    return any_bool ? j2a_fail((uint8_t)code) : (int32_t)code;
}

void app_text(const char *s, uint8_t length, char **result, uint8_t *result_length) {
    //@ check length <= 16;
    read_all((const uint8_t *)s, length);
    leave((const uint8_t *)s, length, (uint8_t **)result, result_length);
}

void app_grow(uint8_t n, const uint8_t *data, uint8_t length, uint16_t a[3], uint8_t **b, uint8_t *b_length) {
    a[2] = n;
    leave(data, length, b, b_length);
}

/* ------------------------------------------------------------------------------ calls ------ */

/* What the server gives, and what it takes. */
static void call(j2a_call_fn *function) {
    uint8_t *payload = j2a_rx_of[0].payload;
    const uint8_t length = any_u8;
    uint8_t code;
    uint8_t i;
    if (length > J2A_ROOM)
        return;
    for (i = 0; i < J2A_ROOM; i++)
        payload[i] = any_u8;
    elsewhere[any_u8 % J2A_MAX_PAYLOAD] = any_u8;
    place = any_u8 % 3;
    //@ split length;
    //@ split place;
    j2a_rx_of[0].length = length;
    j2a_rx_of[0].checksum = any_u8;
    code = function(&j2a_rx_of[0].length, &payload);
    //@ check code == 0 || j2a_rx_of[0].length == 0;
    //@ check j2a_rx_of[0].length == 0 || \valid_read(payload + (0 .. j2a_rx_of[0].length - 1));
    (void)code;
}

static void transfer(void) {
    uint8_t *data = &j2a_rx_of[0].payload[J2A_MANY_HEADER];
    uint32_t offset = any_u32;
    uint8_t length = any_u8;
    bool is_last = any_bool;
    if (length > J2A_ROOM_MANY)
        return;
    //@ split length;
    if (offset > sizeof app_buffer)
        offset = sizeof app_buffer + 1; /* all are alike */
    //@ split offset;
    app_buffer[any_u8 % 20] = any_u16;
    j2a_buffer_buffer(&is_last, any_bool, &offset, &length, &data);
    //@ check length <= J2A_ROOM_MANY;
}

static void send(void) {
    static uint8_t v[3];
    static uint16_t w[J2A_MAX_PAYLOAD];
    static char s[J2A_MAX_PAYLOAD];
    const point p = {(int16_t)any_u16, {any_u8, any_u8}, any_u8};
    const uint8_t count = any_u8;
    v[any_u8 % 3] = any_u8;
    w[count % J2A_MAX_PAYLOAD] = any_u16;
    s[count % J2A_MAX_PAYLOAD] = (char)any_u8;
    j2a_sif_fixed(any_u16, any_u8);
    j2a_sif_fields(&p, v, w, count);
    j2a_sif_words(any_u8, s, count);
    j2a_sif_name(s, count);
}

/* One call from any state: what a call leaves is one of those in which the next one begins. */
int main(void) {
    switch (any_u8) {
    case 0:
        call(j2a_call_all);
        break;
    case 1:
        call(j2a_call_numbers);
        break;
    case 2:
        call(j2a_call_ratio);
        break;
    case 3:
        call(j2a_call_nothing);
        break;
    case 4:
        call(j2a_call_list);
        break;
    case 5:
        call(j2a_call_code);
        break;
    case 6:
        call(j2a_call_text);
        break;
    case 7:
        call(j2a_call_grow);
        break;
    case 8:
        transfer();
        break;
    default:
        send();
        break;
    }
    return 0;
}
