/* Ultrasonic sensors SRF02 on an I2C bus. In: nothing but the sensors. Out: a call for each measurement with its
 * centimetres.
 * All of them measure at once, which takes 65 ms, and are read after 70 ms; then the values of all are given one after the
 * other, and they measure again. With the key trigger they measure once for each srf02_trigger(), each less than 0.5 ms
 * later than the one before; the time of a value is that at which all were read. A sensor sees nothing nearer than about
 * 16 cm. One that is not there, that does not answer, or that sees nothing gives SRF02_NA.
 * Rules: srf02_task() never waits, and is called in each turn of the main loop, at least each 100 ms; the callback runs
 * in it. A transfer that takes longer than SRF02_LIMIT_MS is given up, so a bus that hangs delays nothing else.
 * Sensor 0 has the address 0x70 (0xE0 in its documentation), sensor 1 0x71, and so on. */
#ifndef SRF02_H
#define SRF02_H

#include <stdint.h>

#ifndef SRF02_COUNT
#define SRF02_COUNT 12 /* up to 16 */
#endif
#define SRF02_NA 0x00FFFFFF

enum { SRF02_ADDRESS = 0x70, SRF02_MEASURES_MS = 70, SRF02_LIMIT_MS = 5 };

/* The callback for new values, NULL for none. */
void srf02_set_cb(void (*new_value)(uint8_t channel, uint32_t cm));

/* Switches the bus on. */
void srf02_init(void);

void srf02_task(void);

/* Measures once; behind the measurement that is running, if one is. */
void srf02_trigger(void);

#endif
