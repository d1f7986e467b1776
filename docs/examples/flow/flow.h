/* A flow meter that gives a pulse for each turn of its wheel. In: pulses. Out: their number, for functions and
 * the main loop.
 * Rule: who wants the number calls pulses_total(); the counter itself belongs to the interrupt. */
#ifndef FLOW_H
#define FLOW_H

#include "j2a_functions.h"

enum {
    ALARM_PASSED = 0x01, /* a return value of setAlarm: so many have been counted already */
    SIF_ALARM = 0x40,    /* u32 pulses; the alarm is off then */
    SIF_MEASURED = 0x41  /* u8 number of the window, u16 pulses in it */
};

void pulses_start(void);
uint32_t pulses_total(void);

/* Of the last LOG_SAMPLES tenths of a second, the oldest first: u16 pulses, as bytes for the host.
 * Returns how many bytes. */
enum { LOG_SAMPLES = 150 };
uint16_t log_copy(uint8_t *bytes);

/* Arms the alarm of the link j2a_link. */
void alarm_at(uint32_t pulses);

#endif
