#define J2A_TICKS_PER_MS 2000u
#define J2A_PORT_NAME "bench"
