/* An actuator that is a pin, PB0, and a sensor that answers a trigger by an edge of PB1. The main loop has turns of
 * different lengths, as one with drivers has. */
#include <avr/io.h>

#include "transds.h"

void pin_set(uint8_t channel, uint8_t value) {
    (void)channel;
    if (value)
        PORTB |= _BV(PB0);
    else
        PORTB &= (uint8_t)~_BV(PB0);
}

static void (*strobe_cb)(uint8_t channel, uint8_t value);

void strobe_set_cb(void (*callback)(uint8_t channel, uint8_t value)) {
    strobe_cb = callback;
}

void strobe_trigger(void) {
    PINB = _BV(PB1);
    strobe_cb(0, 1);
}

void j2a_app_task(void) {
    static uint8_t turn;
    volatile uint8_t wait;
    for (wait = turn & 63; wait != 0; wait--) {
    }
    turn = (uint8_t)(turn + 37);
    transds_process();
}

int main(int argc, char **argv) {
    j2a_port_init(argc, argv);
    DDRB = _BV(PB0) | _BV(PB1);
    transds_init();
    for (;;) {
        j2a_task();
        j2a_app_task();
        j2a_port_idle();
    }
}
