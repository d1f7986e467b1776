/* Data addresses and bits of the USB device controller's general registers, the same on all its chips. */
#ifndef J2A_SIM_USB_REGISTERS_H
#define J2A_SIM_USB_REGISTERS_H

enum { PLLCSR = 0x49, PLLFRQ = 0x52, CLKPR = 0x61, REGCR = 0x63, MCUSR = 0x54 };
enum { UHWCON = 0xd7, USBCON, USBSTA, USBINT, UDCON = 0xe0, UDINT, UDIEN, UDADDR, UDFNUML, UDFNUMH, UDMFN };
enum { UEINTX = 0xe8, UENUM, UERST, UEBCHX = 0xf3, UEINT };
/* Reserved on all these chips: the levels of the two interrupts, where simavr looks for enable bits. */
enum { LEVELS = 0xff };
enum { USBE = 0x80, FRZCLK = 0x20, OTGPADE = 0x10, VBUSTE = 1, UVREGE = 1, PLLE = 2, PLOCK = 1 };
enum { DETACH = 1, RMWKUP = 2, LSM = 4 };
enum { SUSPI = 1, SOFI = 4, EORSTI = 8, WAKEUPI = 0x10, EORSMI = 0x20, UPRSMI = 0x40, UD_EVENTS = 0x7d };

#endif
