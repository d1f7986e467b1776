/* Both ends of the wire of `j2a sync verify`: an actuator that is a pin, PB0, and a sensor whose interrupt stamps each
 * edge of another pin, PD2. */
#include <avr/interrupt.h>
#include <avr/io.h>

#include "transds.h"

void lamp_set(uint8_t channel, uint8_t value) {
    (void)channel;
    if (value)
        PORTB |= _BV(PB0);
    else
        PORTB &= (uint8_t)~_BV(PB0);
}

static void (*edge_cb)(uint8_t channel, uint8_t value);

void edge_set_cb(void (*callback)(uint8_t channel, uint8_t value)) {
    edge_cb = callback;
    EICRA = _BV(ISC00); /* each edge of INT0 */
    EIFR = _BV(INTF0);
    EIMSK = _BV(INT0);
}

ISR(INT0_vect) {
    edge_cb(0, (PIND & _BV(PD2)) != 0);
}

void j2a_app_task(void) {
    transds_process();
}

int main(int argc, char **argv) {
    j2a_port_init(argc, argv);
    DDRB = _BV(PB0);
    transds_init();
    for (;;) {
        j2a_task();
        j2a_app_task();
        j2a_port_idle();
    }
}
