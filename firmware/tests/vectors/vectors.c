/* Runs the golden vectors against the C parser and sender by the self-test. Out: the property. */
#include <stdio.h>
#include <stdlib.h>

#include "j2a_internal.h"

/* The self-test sends nothing. */
void j2a_port_tx(uint8_t byte) {
    (void)byte;
    abort();
}

/* The rest of the core, which is not run, asks for it. */
int16_t j2a_port_rx(void) {
    return -1;
}

uint16_t j2a_port_ticks(void) {
    return 0;
}

int main(void) {
    uint8_t text[J2A_MANY_DATA];
    uint8_t length = 0;
    bool is_last = true;
    j2a_selftest();
    j2a_selftest_property(0, 0, &is_last, &length, text);
    printf("%s=%s\n", (char *)text, (char *)text + sizeof "j2a.selftest");
    return !is_last;
}
