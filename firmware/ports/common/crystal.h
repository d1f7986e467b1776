/* A crystal that is off, for tests of hosts that discipline a clock (J2A_WITH_SYNC). In: the true time that passed, and
 * of the environment J2A_DRIFT_PPM, by which it runs fast, and J2A_WANDER_PPM, by up to which it wanders around that.
 * Out: what such a crystal counts. */
#ifndef CRYSTAL_H
#define CRYSTAL_H

#include <stdint.h>

/* true_us: microseconds since the start. */
uint64_t crystal_us(uint64_t true_us);

#endif
