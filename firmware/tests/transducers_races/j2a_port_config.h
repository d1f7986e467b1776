#define J2A_TICKS_PER_MS 1u
#define J2A_PORT_NAME "races"
