/* Takes all packets of endpoint 2 without reading them, and sends 64 bytes on endpoint 1 whenever it can,
 * both with BANKS banks. It needs no enumeration: all endpoints are ready after each bus reset. */
#include <avr/io.h>

static void endpoint(uint8_t number, uint8_t kind, uint8_t size)
{
    UENUM = number;
    UECONX = 1 << EPEN;
    UECFG0X = kind;
    UECFG1X = size;
}

int main(void)
{
    uint8_t size = 3 << EPSIZE0 | (BANKS - 1) << EPBK0 | 1 << ALLOC;
    UHWCON = 1;
    USBCON = 1 << USBE | 1 << OTGPADE;
    PLLCSR = 1 << PINDIV | 1 << PLLE;
    while (!(PLLCSR & 1 << PLOCK))
        ;
    UDCON = 0;
    for (;;) {
        if (UDINT & 1 << EORSTI) {
            UDINT = 0;
            endpoint(0, 0, 3 << EPSIZE0 | 1 << ALLOC);
            endpoint(1, 2 << EPTYPE0 | 1, size);
            endpoint(2, 2 << EPTYPE0, size);
        }
        UENUM = 2;
        if (UEINTX & 1 << FIFOCON)
            UEINTX = 0x6b; /* clears RXOUTI and FIFOCON */
        UENUM = 1;
        if (UEINTX & 1 << FIFOCON) {
#define PUT4 UEDATX = 1; UEDATX = 2; UEDATX = 3; UEDATX = 4
#define PUT16 PUT4; PUT4; PUT4; PUT4
            PUT16; PUT16; PUT16; PUT16;
            UEINTX = 0x3a; /* clears TXINI and FIFOCON, leaves KILLBK alone */
        }
    }
}
