/* See ticks.h. */
#include "ticks.h"

uint16_t ticks_of_servo(int8_t deflection) {
    const int8_t limited = deflection > SERVO_FULL ? SERVO_FULL
        : deflection < -SERVO_FULL ? -SERVO_FULL : deflection;
    /* never negative, so that the division rounds to the nearest */
    const uint32_t hundredths_us = (uint32_t)(SERVO_MIDDLE_US * (int32_t)SERVO_FULL
                                              + (int32_t)SERVO_SPAN_US * limited);
    return (uint16_t)((hundredths_us * TICKS_PER_US + SERVO_FULL * TICK_US / 2) / (SERVO_FULL * TICK_US));
}
