/* No transducers, for sketches that list none: the engine is linked with this, or with the table of the sketch. Rule:
 * a file of its own, because avr-gcc 5.4 takes a weak constant that it sees for the one that will be linked. */
#undef J2A_WITH_TRANSDUCERS
#define J2A_WITH_TRANSDUCERS 0
#include "j2a_core.h"

#include "j2a_transds_table.h" /* without transducers, its types alone */

const j2a_transducer J2A_WEAK J2A_FLASH j2a_transducers[1] = {{0}};
const uint8_t J2A_WEAK j2a_transducer_count = 0;
const char J2A_WEAK J2A_FLASH j2a_descriptors[1] = "";
