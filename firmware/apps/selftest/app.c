/* The first app for a new port: built-in functions, and the self-test, which any app can have
 * (OPTIONS="-DJ2A_WITH_SELFTEST=1"). */
#include "j2a.h"

void j2a_app_task(void) {
}
