#define J2A_TICKS_PER_MS ((F_CPU + 63999) / 64000) /* of timer 1, rounded up */
#define J2A_PORT_NAME "avr-serial"
