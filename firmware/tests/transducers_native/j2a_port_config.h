#define J2A_TICKS_PER_MS 1u
#define J2A_PORT_NAME "fake"
#define J2A_PORT_WAIT 1
#define J2A_PORT_IS_UP fake_is_up

#include <stdbool.h>
extern bool fake_is_up;
