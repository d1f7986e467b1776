#define J2A_TICKS_PER_MS 100u
#define J2A_PORT_NAME "posix"
