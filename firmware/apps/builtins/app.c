/* The app without functions of its own: what the protocol itself costs. */
#include "j2a.h"

void j2a_app_task(void) {
}
