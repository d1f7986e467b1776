/* Sends back what comes, by polling. */
#include "uart.h"

int main(void) {
    uart_init(0);
    for (;;)
        put(get());
}
