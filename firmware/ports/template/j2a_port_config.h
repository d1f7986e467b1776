#define J2A_PORT_NAME "template" /* FILL IN: any name; the demo shows it as the property "port" */

/* FILL IN in the second step: 1 when your receive interrupt calls port_receive(). */
#define BOARD_INTERRUPTS 0

/* Ticks of j2a_port_ticks() in a millisecond: those of board_ms(). A pause inside a frame is then given
 * up after 10 to 12 ms; 9 must pass, and 20 are the end (J2A-TIME-001, J2A-TIME-002). */
#define J2A_TICKS_PER_MS 1u
