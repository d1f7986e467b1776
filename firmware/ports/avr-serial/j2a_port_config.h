#define J2A_TICKS_PER_MS (F_CPU / 8000u)
#define J2A_PORT_NAME "avr-serial"
