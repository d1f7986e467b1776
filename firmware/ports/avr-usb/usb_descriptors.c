/* What the board tells the host: descriptors, strings, serial number. In: the variables of port.mk. Out:
 * bytes in flash.
 * Rules: one configuration; the layout is that of the USB 2.0 specification, 9.6, and the numbers are
 * those of spec/LINKS.md. */
#include <avr/boot.h>
#include <avr/pgmspace.h>
#include <stddef.h>

#include "usb.h"
#include "j2a_port.h"

#if USB_VENDOR < 1 || USB_VENDOR > 0xFFFF || USB_PRODUCT < 0 || USB_PRODUCT > 0xFFFF
#error "USB_VENDOR must be 0x0001..0xFFFF, USB_PRODUCT 0x0000..0xFFFF"
#endif

enum { DEVICE = 1, CONFIGURATION, STRING, INTERFACE, ENDPOINT }; /* types of descriptors */
enum { LANGUAGES, MANUFACTURER, PRODUCT, SERIAL_NUMBER, SYNCUSB }; /* numbers of strings */
enum { ENGLISH = 0x0409, BULK = 2, INTERRUPT = 3, BUS_POWERED = 0x80, MILLIAMPERES = 100 };

#define BYTES(word) (uint8_t)(word), (uint8_t)((word) >> 8)
#define CONFIGURATION_SIZE (9 + 9 * USB_INTERFACES + 7 * USB_ENDPOINTS)

static const uint8_t device[] PROGMEM = {
    18, DEVICE, BYTES(0x0200), 0, 0, 0, USB_PACKET0, BYTES(USB_VENDOR), BYTES(USB_PRODUCT), BYTES(0x0100),
    MANUFACTURER, PRODUCT, SERIAL_NUMBER, 1};

static const uint8_t configuration[] PROGMEM = {
    9, CONFIGURATION, BYTES(CONFIGURATION_SIZE), USB_INTERFACES, 1, 0, BUS_POWERED, MILLIAMPERES / 2,
    9, INTERFACE, 0, 0, 2, J2A_USB_CLASS, J2A_USB_SUBCLASS, J2A_USB_PROTOCOL, 0,
    7, ENDPOINT, J2A_USB_IN, BULK, BYTES(J2A_USB_PACKET), 0,
    7, ENDPOINT, J2A_USB_OUT, BULK, BYTES(J2A_USB_PACKET), 0,
#if J2A_WITH_SYNCUSB
    9, INTERFACE, 1, 0, 1, J2A_USB_CLASS, J2A_SYNCUSB_SUBCLASS, J2A_SYNCUSB_PROTOCOL, SYNCUSB,
    /* Packets of exactly what is sent, although the controller has room for 16: bus time is set aside for
     * no more. */
    7, ENDPOINT, J2A_SYNCUSB_OUT, INTERRUPT, BYTES(J2A_SYNCUSB_SIZE), 1,
#endif
};

/* A string descriptor, without the NUL; so it is as long as the literal. */
#define STRING_DESCRIPTOR(name, literal)                       \
    static const struct {                                      \
        uint8_t size, type;                                    \
        wchar_t text[sizeof(literal) - (sizeof(literal) > 1)]; \
    } name PROGMEM = {sizeof(L"" literal), STRING, L"" literal}
STRING_DESCRIPTOR(manufacturer, "J2A");
STRING_DESCRIPTOR(product, USB_NAME);
STRING_DESCRIPTOR(serial, USB_SERIAL);
#if J2A_WITH_SYNCUSB
STRING_DESCRIPTOR(syncusb, "SyncUSB");
#endif
static const uint8_t languages[] PROGMEM = {4, STRING, BYTES(ENGLISH)};

/* By their numbers; NULL is the serial number that the chip was made with. */
static const void *const strings[] PROGMEM = {
    languages, &manufacturer, &product, sizeof(USB_SERIAL) > 1 ? &serial : NULL,
#if J2A_WITH_SYNCUSB
    &syncusb
#endif
};

/* That number is in the signature row. As hexadecimal digits it has no room in RAM, so it is made while it
 * is sent. The lower half of a byte comes first, as other firmware for these chips shows it. */
enum { CHIP_SERIAL_AT = 0x0E, CHIP_SERIAL_BYTES = 10, CHIP_SERIAL_SIZE = 2 + 2 * 2 * CHIP_SERIAL_BYTES };

uint8_t usb_descriptor_byte(uint8_t index) {
    uint8_t digit;
    if (index == 0)
        return CHIP_SERIAL_SIZE;
    if (index == 1)
        return STRING;
    if (index & 1)
        return 0;
    digit = boot_signature_byte_get(CHIP_SERIAL_AT + (index - 2) / 4);
    if ((index & 2) == 0)
        digit >>= 4;
    digit &= 0x0F;
    return (uint8_t)(digit < 10 ? '0' + digit : 'A' - 10 + digit);
}

uint8_t usb_descriptor(uint8_t type, uint8_t number, uint16_t index, const uint8_t **at) {
    *at = NULL;
    if (type == STRING) { /* whatever the language is, there is but one */
        if (number >= sizeof strings / sizeof *strings)
            return 0;
        *at = pgm_read_ptr(&strings[number]);
        return *at ? pgm_read_byte(*at) : CHIP_SERIAL_SIZE;
    }
    if (number != 0 || index != 0)
        return 0;
    if (type == DEVICE) {
        *at = device;
        return sizeof device;
    }
    if (type == CONFIGURATION) {
        *at = configuration;
        return sizeof configuration;
    }
    return 0;
}
