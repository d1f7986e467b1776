#define J2A_TICKS_PER_MS 1u
#define J2A_PORT_NAME "fake"
#ifndef J2A_PORT_FRAMES
#define J2A_PORT_FRAMES 1
#endif
#define J2A_PORT_WAIT 1
