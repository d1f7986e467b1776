/* Options of the port, see firmware/README.md, and what it offers applications. */
#ifndef J2A_PORT_CONFIG_H
#define J2A_PORT_CONFIG_H

#include <stdint.h>

#include "avr_clock.h"
#include "avr_eeprom.h"
#include "avr_reset.h"

#define J2A_TICKS_PER_MS AVR_CLOCK_TICKS_PER_MS
#define J2A_PORT_NAME "avr-usb"
#define J2A_PORT_BOOT_CAUSE avr_early_cause

/* A host has configured the board, and does not let it sleep: see usb.h. */
extern volatile uint8_t usb_trouble;
#define J2A_PORT_IS_UP (usb_trouble == 0)

/* Some of these chips have 1 KB of RAM. Not in a build that sends no samples, whose parser stays as it is. */
#if defined J2A_WITH_TRANSDUCERS
#define J2A_PORT_SHARES_ROOM J2A_WITH_TRANSDUCERS
#endif

/* The interface SyncUSB, by which the host tells its time. Off: it is not there. */
#ifndef J2A_WITH_SYNCUSB
#define J2A_WITH_SYNCUSB 1
#endif

/* Sleeps in power-down mode while the bus is suspended, with timer 1 standing still. Without it the
 * application goes on until it has to send, and the chip takes far more than the 2.5 mA that a suspended board
 * may take from the bus. */
#ifndef J2A_USB_SLEEP
#define J2A_USB_SLEEP 0
#endif
/* The starts of frames lead the clock. */
#define J2A_PORT_FRAMES (J2A_WITH_SYNC && J2A_WITH_SYNCUSB)
#if J2A_PORT_FRAMES
void usb_quiet(uint16_t due);
#define AVR_CLOCK_QUIET(due) usb_quiet(due)
#endif

#if ((J2A_WITH_SYNCUSB | J2A_USB_SLEEP) & ~1) != 0
#error "J2A_WITH_SYNCUSB and J2A_USB_SLEEP must be 0 or 1"
#endif

/* An application may implement this; it gets each packet of SyncUSB, in the main loop.
 * packet: J2A_SYNCUSB_SIZE bytes, the least significant first: u64 microseconds since the Unix epoch, and u16
 * number of the USB frame that began then; UDFNUM is that of the current frame. */
#if J2A_WITH_SYNCUSB
void j2a_app_sync_usb(const uint8_t *packet);
#endif

#endif
