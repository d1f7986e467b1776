/* No protocol: each byte that the port receives goes back as it is. It shows whether a new port's link
 * carries bytes, before anything else can be wrong (docs/examples/echo_bytes.py is the other end). */
#include "j2a.h"

int main(int argc, char **argv) {
    j2a_port_init(argc, argv);
    for (;;) {
        const int16_t byte = j2a_port_rx();
        if (byte >= 0)
            j2a_port_tx((uint8_t)byte);
        else
            j2a_port_idle();
    }
}
