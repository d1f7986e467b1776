/* See quadrature.h. A row for each state before, a column for each state now. */
#include "quadrature.h"

#define X QUADRATURE_ILLEGAL

const int8_t J2A_FLASH quadrature_steps[16] = {
    0, 1, -1, X, /* from 00 */
    -1, 0, X, 1, /* from A  */
    1, X, 0, -1, /* from B  */
    X, -1, 1, 0  /* from AB */
};
