/* See avr_eeprom.h. */
#include "avr_eeprom.h"

#include <avr/eeprom.h>

#include "j2a_port.h"

#if J2A_WITH_SAVE

static uint8_t *place(uint16_t at) {
    return (uint8_t *)(J2A_EEPROM_AT + at);
}

uint8_t j2a_port_kept(uint16_t at) {
    return eeprom_read_byte(place(at));
}

bool j2a_port_keep(uint16_t at, uint8_t byte) {
    if (!eeprom_is_ready())
        return false;
    if (eeprom_read_byte(place(at)) == byte)
        return true;
    eeprom_write_byte(place(at), byte);
    return false;
}

#else
typedef int avr_eeprom_is_left_out; /* C has no empty files */
#endif
