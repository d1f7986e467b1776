/* Settings of the core in this library. Any option of j2a_core.h may be set here, before the lines below, or
 * by the compiler's -D for the library and the sketch alike (PlatformIO: build_flags). */
#define J2A_PORT_NAME "arduino"
#define J2A_TICKS_PER_MS 1u /* of millis() */
#define J2A_PORT_LINKS 255  /* as many streams as a sketch has */

/* Functions are described to the host: about 800 bytes of flash. Without, J2A_FUNCTION tells their names only. */
#ifndef J2A_WITH_INTERFACE
#define J2A_WITH_INTERFACE 1
#endif

/* The engine of transducers is compiled with the library, and linked into sketches that list some. */
#define J2A_TRANSDUCERS_APART 1
#ifndef J2A_WITH_TRANSDUCERS
#if (defined J2A_WITH_SIF && !J2A_WITH_SIF) || (defined J2A_WITH_MAPPING && !J2A_WITH_MAPPING) || \
    (defined J2A_WITH_MANY && !J2A_WITH_MANY) || (defined J2A_WITH_PROPERTIES && !J2A_WITH_PROPERTIES) || \
    (defined J2A_WITH_CLOCK && !J2A_WITH_CLOCK)
#define J2A_WITH_TRANSDUCERS 0
#else
#define J2A_WITH_TRANSDUCERS 1
#endif
#endif

#if defined J2A_WITH_SAVE && J2A_WITH_SAVE
#error "J2A_WITH_SAVE=1: a sketch cannot keep the settings of transducers without power"
#endif

/* Bytes that are collected and written at once. An AVR's Serial has a buffer of its own; with USB elsewhere
 * each write may become a packet. */
#ifndef J2A_TXBUF
#ifdef __AVR__
#define J2A_TXBUF 0
#else
#define J2A_TXBUF 64
#endif
#endif
