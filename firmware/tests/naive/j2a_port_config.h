/* The template's, with a name. */
#define J2A_PORT_NAME "naive"

#define BOARD_INTERRUPTS 0

#define J2A_TICKS_PER_MS 1u
