#define J2A_TICKS_PER_MS 10u
#define J2A_PORT_NAME "fuzz"
