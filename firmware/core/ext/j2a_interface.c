/* The interface: what the tables have in flash flows out as text, byte by byte, the definitions first and then a
 * line for each function. Chunks of it are read by a2jGetInterface, and its CRC-32 is a property.
 * Rule: no RAM, so each reader walks from the first byte. */
#include "j2a_internal.h"

#if J2A_WITH_INTERFACE

/* Hosts find a2jGetInterface in the mapping, so the mapping must hold it (J2A-IFACE-007): a negative array size
 * stops the build otherwise. */
typedef char j2a_interface_needs_a_larger_J2A_ROOM[J2A_BUILTIN_SIZE <= J2A_ROOM ? 1 : -1];

static const char J2A_FLASH many[] = " many";

typedef struct {
    const char *next; /* in flash */
    uint16_t line;    /* opcode of the function whose line comes next */
    bool is_many;     /* of the line so far: a function of kind many, and no signature yet */
} walk_t;

/* Returns the next byte of the interface, NUL behind its end. */
static uint8_t take(walk_t *walk) {
    uint8_t c = j2a_flash_u8(walk->next);
    if (c == 0 && walk->is_many) {
        walk->next = many;
        c = (uint8_t)' ';
    }
    if (c == ' ' || c == '(')
        walk->is_many = false;
    if (c != 0) {
        walk->next++;
        return c;
    }
    if (walk->line > j2a_function_count)
        return 0;
    if (walk->line < j2a_function_count) {
        const j2a_entry *const entry = j2a_entry_of((uint8_t)walk->line);
        walk->next = j2a_flash_pointer(&entry->name);
        walk->is_many = j2a_flash_u8(&entry->kind) == J2A_KIND_MANY;
    }
    walk->line++;
    return (uint8_t)'\n';
}

uint8_t j2a_get_interface(bool *is_last, bool is_write, uint32_t *const offset, uint8_t *const length,
                          uint8_t **const data) {
    walk_t walk = {j2a_definitions(), 0, false};
    size_t at = 0;
    uint8_t n = 0;
    uint8_t c;

    *length = 0;
    if (is_write)
        return J2A_RET_FAILED;
    *is_last = true;
    for (; (c = take(&walk)) != 0; at++) {
        if (at < *offset)
            continue;
        if (n == J2A_ROOM_MANY) {
            *is_last = false;
            break;
        }
        (*data)[n++] = c;
    }
    *length = n;
    return 0;
}

/* Bit by bit: a table would be longer than the rest of this file. */
#if !J2A_WITH_BOOT
static
#endif
uint32_t j2a_interface_hash(void) {
    walk_t walk = {j2a_definitions(), 0, false};
    uint32_t crc = 0xFFFFFFFF;
    uint8_t c;
    while ((c = take(&walk)) != 0) {
        uint8_t bit;
        crc ^= c;
        for (bit = 0; bit < 8; bit++)
            crc = crc >> 1 ^ ((crc & 1) != 0 ? 0xEDB88320 : 0);
    }
    return ~crc;
}

void j2a_interface_property(size_t at, uint32_t offset, bool *is_last, uint8_t *length, uint8_t *data) {
    static const char J2A_FLASH key[] = "j2a.interface";
    char property[J2A_INTERFACE_BYTES];
    uint32_t crc = j2a_interface_hash();
    size_t i;
    for (i = 0; i < sizeof key; i++)
        property[i] = (char)j2a_flash_u8(&key[i]);
    for (; i < J2A_INTERFACE_BYTES - 1; i++, crc <<= 4) {
        const uint8_t digit = (uint8_t)(crc >> 28);
        property[i] = (char)(digit < 10 ? '0' + digit : 'a' + digit - 10);
    }
    property[i] = '\0';
    j2a_append(property, J2A_INTERFACE_BYTES, at, offset, is_last, length, data);
}

#endif
