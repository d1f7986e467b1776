/* The microcontrollers: those of simavr, those that it has a near relative of, and mends of its models.
 *
 * In:  a name. Out: a simulator of that chip, or NULL.
 * AT90USB82, ATmega8U2, 16U2 and 32U2 are AT90USB162s with other memories, and so is the ATmega16U4 an
 * ATmega32U4: same registers, same vectors.
 * simavr takes a timer's normal and CTC modes for fast PWM when it sets the outputs of compare units: each
 * write to a compare register inverts them. Its outputs are let through only where a match can mean them.
 * simavr looks at a low pin of a level interrupt in each cycle: here only while the interrupt is on.
 * A pin that a compare unit drives is seen in its PORT bit as well, unlike on the chip.
 */
#ifndef J2A_SIM_MCU_H
#define J2A_SIM_MCU_H

#include "sim_avr.h"
#include "avr_timer.h"

enum { MCU_OUTPUTS = 24 };

typedef struct {
    avr_timer_t *timer;
    avr_timer_comp_t *unit;
    avr_regbit_t port;
    avr_irq_t *pin;
} mcu_output_t;

typedef struct {
    mcu_output_t outputs[MCU_OUTPUTS];
    int count;
} mcu_t;

/* The names of the chips that simavr lacks, from 0 on; NULL after the last one. */
const char *mcu_relative(unsigned number);
/* As avr_make_mcu_by_name(); call mcu_mend() after avr_init(), with memory that lives as long. */
avr_t *mcu_make(const char *name);
void mcu_mend(mcu_t *, avr_t *);
/* Whether it is an AT90USB162 or one of those that run as it. */
int mcu_is_usb162(const avr_t *);

#endif
