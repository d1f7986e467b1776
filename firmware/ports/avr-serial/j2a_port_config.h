#define J2A_TICKS_PER_MS (F_CPU / 64000) /* of timer 1 */
#define J2A_PORT_NAME "avr-serial"
