/* Arithmetic with the ticks of timer 1, which avr-serial lets run freely: at 16 MHz a tick is 4 us, and 0.5 us where
 * the host disciplines the clock.
 * In: a servo's deflection. Out: ticks. */
#ifndef TICKS_H
#define TICKS_H

#include <stdint.h>

#if F_CPU == 16000000 || F_CPU == 8000000 || F_CPU == 4000000 || F_CPU == 2000000 || F_CPU == 1000000
/* As AVR_CLOCK_DIVIDER of the port. */
#if defined J2A_WITH_SYNC && J2A_WITH_SYNC
#define TICK_CYCLES 8
#else
#define TICK_CYCLES 64
#endif
#if TICK_CYCLES * 1000000 >= F_CPU
#define TICK_US (TICK_CYCLES * 1000000 / F_CPU)
#define TICKS_PER_US 1
#else
#define TICK_US 1
#define TICKS_PER_US (F_CPU / 1000000 / TICK_CYCLES)
#endif
#define TICKS_OF_US(us) ((us) / TICK_US * TICKS_PER_US)
#else
#error "F_CPU must be 1, 2, 4, 8 or 16 MHz: then a tick is no odd part of a microsecond"
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

/* The ticks of a servo's pulse for -SERVO_FULL..SERVO_FULL; what is beyond counts as full. Off by half a
 * tick at most. */
uint16_t ticks_of_servo(int8_t deflection);

#endif
