/* Sets a servo's deflection at a cycle that can be chosen. In: the variables below, written by the simulator.
 * Out: servo 0's pulses; `go` is 0 again when it was set.
 * Rule: the time counts from servo 1's interrupt, half a period before servo 0's pulse begins, in which the chip
 * sleeps; so it is the same cycle each time. */
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>
#include <util/delay_basic.h>

#include "servo.h"
#include "ticks.h"

volatile uint8_t go, cycles; /* 0..3 of them, and ... */
volatile uint16_t fours;     /* ... so many times 4 */
volatile int8_t deflection;

static uint16_t ticks_to_edge(void) {
    uint16_t ticks;
    cli();
    ticks = OCR1A - TCNT1;
    sei();
    return ticks;
}

int main(void) {
    const uint16_t half = SERVO_PERIOD_US / TICK_US / 2;
    TCCR1B = _BV(CS11) | _BV(CS10);
    servo_init();
    sei();
    for (;;) {
        uint16_t ticks;
        sleep_enable();
        sleep_cpu();
        ticks = ticks_to_edge();
        if (!go || ticks > half || ticks < half - 9)
            continue;
        _delay_loop_2(fours);
        /* RJMP takes one cycle more than being skipped. */
        asm volatile("sbrc %0, 0\n rjmp .+0\n"
                     "sbrc %0, 1\n rjmp .+0\n"
                     "sbrc %0, 1\n rjmp .+0\n" ::"r"(cycles));
        servo_set(0, deflection);
        go = 0;
    }
}
