#define J2A_TICKS_PER_MS 8u /* of 256 / (F_CPU / 8) = 128 us: 7.8, rounded up */
#define J2A_PORT_NAME "avr-serial"
