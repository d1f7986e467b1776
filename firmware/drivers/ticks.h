/* Arithmetic with the ticks of timer 1, which avr-serial lets run freely at F_CPU / 64 and which wraps at
 * 65536: 4 us a tick and 262 ms around at 16 MHz.
 * In: ticks that an interrupt noted, a servo's deflection. Out: microseconds of the device's clock, ticks.
 * Rule: a noted tick is turned into microseconds before the timer has gone around. */
#ifndef TICKS_H
#define TICKS_H

#include <stdint.h>

#if F_CPU == 16000000 || F_CPU == 8000000 || F_CPU == 4000000 || F_CPU == 2000000 || F_CPU == 1000000
#define TICK_US (64000000 / F_CPU)
#else
#error "F_CPU must be 1, 2, 4, 8 or 16 MHz: then a tick is a whole number of microseconds"
#endif

/* A servo's pulse: middle, and what full deflection adds. Each servo bears 500 us; many go to 1000, where
 * most hit their stops. The period is what servos expect. */
#define SERVO_MIDDLE_US 1500
#ifndef SERVO_SPAN_US
#define SERVO_SPAN_US 500
#endif
#if SERVO_SPAN_US < 1 || SERVO_SPAN_US > 1000
#error "SERVO_SPAN_US must be 1..1000"
#endif
#define SERVO_PERIOD_US 20000
enum { SERVO_FULL = 100 };

/* When it was `tick`, on the clock that now says `now_us`. The clock counts the same ticks, so this is exact. */
uint64_t ticks_time_us(uint64_t now_us, uint16_t tick);

/* How old a tick is now, in ticks. */
uint16_t ticks_age(uint64_t now_us, uint16_t tick);

/* The ticks of a servo's pulse for -SERVO_FULL..SERVO_FULL; what is beyond counts as full. Off by half a
 * tick at most. */
uint16_t ticks_of_servo(int8_t deflection);

#endif
