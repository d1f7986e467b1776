/* What stays without power, for ports with files (J2A_WITH_SAVE). In: the environment variable J2A_KEPT, which names a
 * file. Out: its bytes, as an EEPROM has them; without the variable a device begins with an empty one each time. */
#define _XOPEN_SOURCE 600

#include "j2a_port.h"

#if J2A_WITH_SAVE

#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

static uint8_t kept[J2A_PORT_KEPT_BYTES];
static int fd = -1;

static void fail(const char *what) {
    perror(what);
    exit(EXIT_FAILURE);
}

static void open_once(void) {
    static bool is_open;
    const char *const name = getenv("J2A_KEPT");
    if (is_open)
        return;
    is_open = true;
    memset(kept, 0xFF, sizeof kept); /* as an EEPROM that nobody has written to */
    if (!name)
        return;
    fd = open(name, O_RDWR | O_CREAT, 0666);
    if (fd < 0 || pread(fd, kept, sizeof kept, 0) < 0 || pwrite(fd, kept, sizeof kept, 0) < 0)
        fail(name);
}

uint8_t j2a_port_kept(uint16_t at) {
    open_once();
    return kept[at];
}

bool j2a_port_keep(uint16_t at, uint8_t byte) {
    open_once();
    if (kept[at] == byte)
        return true;
    if (fd < 0 || pwrite(fd, &byte, 1, at) == 1)
        kept[at] = byte; /* else as a worn cell: the core tries again for a while, and then says so */
    return false;
}

#endif
