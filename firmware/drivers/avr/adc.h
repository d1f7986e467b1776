/* Four analog inputs. In: their voltages. Out: a call for each conversion with its counts, 0..1023 for 0 V to
 * AVCC, and the newest counts.
 * Rules: adc_start() begins a scan, one conversion for each input in turn; the conversions' interrupts do the
 * rest, 104 us each at 16 MHz (13 periods of the ADC's clock, which is F_CPU / 128). The callback runs in
 * the interrupt, with other interrupts on, and the next conversion waits for it. A value is as it
 * was 12 us after its conversion began. Several may begin scans: a scan has values for all. With the key trigger the
 * callback gets one scan for each adc_trigger(), and nothing else begins one but the driver of another sensor. */
#ifndef ADC_H
#define ADC_H

#include <stdint.h>

enum { ADC_COUNT = 4, ADC_PERIOD_MS = 5 };

/* May be called again, as long as no scan is running. */
void adc_init(void);

/* The callback for new values, NULL for none. Called by the interrupt. */
void adc_set_cb(void (*new_value)(uint8_t channel, uint16_t value));

/* Begins a scan each ADC_PERIOD_MS, unless it is triggered. Called in each turn of the main loop. */
void adc_task(void);

/* Measures once. Called from the main context, as all of the rest but adc_start(). */
void adc_trigger(void);

/* Begins a scan. One that is running counts if this began it and its first conversion runs, else another one follows
 * it. Returns what adc_scans() is when it is over. */
uint8_t adc_scan(void);

/* Begins a scan, unless one is running. May be called by an interrupt. */
void adc_start(void);

/* How many scans are over, modulo 256. */
uint8_t adc_scans(void);

/* The counts of the last conversion of an input, 0 before the first one. */
uint16_t adc_get(uint8_t channel);

#endif
