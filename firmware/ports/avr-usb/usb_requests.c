/* The standard requests of chapter 9 of the USB 2.0 specification, see usb.h. In: a SETUP packet. Out: what
 * is to be sent, and the endpoints as the host wants them.
 * Rule: a request is judged whole, wIndex and wLength too, before anything is done; what is not of chapter
 * 9, or not allowed in the state that the device is in, is refused. */
#include <avr/pgmspace.h>

#include "usb.h"

enum { /* bmRequestType << 4 | bRequest: both are this small in standard requests, bit 7 moves down to 6 */
    GET_STATUS_OF_DEVICE = 0x40,
    GET_STATUS_OF_INTERFACE = 0x50,
    GET_STATUS_OF_ENDPOINT = 0x60,
    CLEAR_FEATURE_OF_ENDPOINT = 0x21,
    SET_FEATURE_OF_ENDPOINT = 0x23,
    SET_ADDRESS = 0x05,
    GET_DESCRIPTOR = 0x46,
    GET_CONFIGURATION = 0x48,
    SET_CONFIGURATION = 0x09,
    GET_INTERFACE = 0x5A,
    SET_INTERFACE = 0x1B
};
#if J2A_PORT_FRAMES
const uint8_t *usb_in_ram;
#endif
static const uint8_t answers[] PROGMEM = {0, 0, 1, 0};
#define ANSWER_0 (answers)
#define ANSWER_1 (answers + 2)

static bool is_configured(void) {
    return !(usb_trouble & USB_UNCONFIGURED);
}

/* Makes the toggle of an endpoint, and its halt, as after a configuration. */
static void refresh(void) {
    UECONX = _BV(EPEN) | _BV(STALLRQC) | _BV(RSTDT);
}

/* Chooses the endpoint that wIndex names. Returns whether there is one. */
static bool choose(uint8_t address) {
    const uint8_t number = address & 0x0F;
    UENUM = 0;
    if ((address & 0x7F) == 0)
        return true;
    if (number == 0 || number > USB_ENDPOINTS || !is_configured()
        || pgm_read_byte(&usb_endpoints[number - 1].address) != address)
        return false;
    UENUM = number;
    return true;
}

/* Starts the endpoints of an interface anew. */
static void set_interface(uint8_t interface) {
    uint8_t i;
    for (i = 0; i < USB_ENDPOINTS; i++) {
        if (pgm_read_byte(&usb_endpoints[i].interface) == interface) {
            UENUM = (uint8_t)(i + 1);
            refresh();
        }
    }
}

uint8_t usb_answer(const usb_setup *setup, const uint8_t **source) {
    const uint8_t value = setup->value;
    const uint8_t index = setup->index;
    uint8_t request = (uint8_t)((setup->type & 0x0F) << 4 | setup->request);
    uint8_t length = 0; /* what wLength has to be */

#if J2A_PORT_FRAMES
    usb_in_ram = 0;
    if (setup->type == J2A_SYNCUSB_REQUEST_TYPE && setup->request == J2A_SYNCUSB_SEEN) {
        if (index != USB_INTERFACES - 1 || setup->index_high != 0 || !is_configured())
            return USB_STALL;
        usb_in_ram = usb_frame_answer(value, setup->value_high);
        return J2A_SYNCUSB_SEEN_SIZE;
    }
#endif
    if ((setup->type & 0x7C) != 0 || setup->request > 0x0F)
        return USB_STALL;
    if (setup->type & 0x80)
        request |= 0x40;
    if (request == GET_DESCRIPTOR) {
        const uint8_t found = usb_descriptor(setup->value_high, value,
                                             (uint16_t)(index | (uint16_t)setup->index_high << 8), source);
        return found != 0 ? found : USB_STALL;
    }
    /* All others have no large numbers. */
    if (setup->value_high | setup->index_high | setup->length_high)
        return USB_STALL;
    if ((request & 0x0F) == 0) {
        length = 2;
    } else if (request & 0x40) {
        length = 1;
    }
    if (setup->length != length)
        return USB_STALL;
    if (request & 0x10) {
        if (!is_configured() || index >= USB_INTERFACES)
            return USB_STALL;
    } else if (request & 0x20) {
        if (!choose(index))
            return USB_STALL;
    } else if (index != 0) {
        return USB_STALL;
    }
    *source = ANSWER_0;
    switch (request) {
    case SET_ADDRESS:
        if (value > 127 || is_configured())
            return USB_STALL;
        usb_new_address = value | _BV(ADDEN);
        return 0;
    case SET_CONFIGURATION:
        if (value > 1 || (UDADDR & (uint8_t)~_BV(ADDEN)) == 0)
            return USB_STALL;
        usb_configure(value);
        return 0;
    case CLEAR_FEATURE_OF_ENDPOINT: /* HALT; there is no other */
        if (value != 0)
            return USB_STALL;
        if (UENUM != 0)
            refresh();
        return 0;
    case SET_FEATURE_OF_ENDPOINT:
        if (value != 0 || UENUM == 0)
            return USB_STALL;
        UECONX = _BV(EPEN) | _BV(STALLRQ);
        return 0;
    case SET_INTERFACE:
        if (value != 0)
            return USB_STALL;
        set_interface(index);
        return 0;
    case GET_STATUS_OF_ENDPOINT:
        if (UENUM != 0 && (UECONX & _BV(STALLRQ)))
            *source = ANSWER_1;
        break;
    case GET_CONFIGURATION:
        if (is_configured())
            *source = ANSWER_1;
        break;
    case GET_STATUS_OF_DEVICE: /* power from the bus, no remote wake-up */
    case GET_STATUS_OF_INTERFACE:
    case GET_INTERFACE:
        break;
    default:
        return USB_STALL;
    }
    return value != 0 ? USB_STALL : length;
}
