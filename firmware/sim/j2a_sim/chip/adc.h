/* The analog-to-digital converter of the simulated AVR, exact to the cycle.
 *
 * In:  volts at the channels and references, register accesses of the firmware.
 * Out: results and interrupts at the times of the data sheet.
 *
 * It takes the place of simavr's own model, which takes a result from the channel that is chosen when
 * the result is read, and not when the conversion was. Here a conversion begins at the next edge of the
 * ADC's clock, samples 1.5 of its periods later (13.5 in the first one after the ADC was switched on)
 * and is ready after 13 (25). Channel and reference are those at the beginning.
 * Modelled: single-ended channels, the internal reference and 0 V as inputs, ADLAR, free running.
 * Any other input (differential, the thermometer) gives 0 and a line in the log, any other trigger no
 * conversion and a line in the log.
 */
#ifndef J2A_SIM_ADC_H
#define J2A_SIM_ADC_H

#include <stdint.h>

#include "sim_avr.h"
#include "avr_adc.h"

enum { ADC_CHANNELS = 16 };

typedef struct {
    avr_t *avr;
    avr_adc_t *port;                  /* NULL: the MCU has none */
    double volts[ADC_CHANNELS];
    double avcc, aref;                /* volts */
    uint64_t enabled;                 /* the cycle at which the ADC's clock began */
    uint64_t ready;                   /* the cycle at which this conversion ends */
    double reference, sample;         /* volts; of the conversion */
    int first, sampled, channel_kind, channel;
    uint16_t result;
    int locked;                       /* ADCL was read, and ADCH not yet */
    uint64_t conversions;
} adc_t;

void adc_attach(adc_t *, avr_t *);
void adc_set_volts(adc_t *, int channel, double volts);

#endif
