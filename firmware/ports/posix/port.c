/* A POSIX process as a device: the link is stdin and stdout, or with --pty a new pseudo-terminal
 * whose name is printed. Ends at the end of input, after all replies, and on SIGTERM and SIGINT. */
#define _XOPEN_SOURCE 600

#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include "crystal.h"
#include "j2a_port.h"

/* Many bytes at once are far cheaper than one by one, so where J2A_TXBUF is left at 0 they are collected, too. */
enum { TX_BYTES = J2A_TXBUF ? J2A_TXBUF : 4096 };

static int in_fd = STDIN_FILENO, out_fd = STDOUT_FILENO;
static uint8_t rx[J2A_RXBUF], tx[TX_BYTES];
static size_t rx_next, rx_used, tx_used;
static bool at_end;
static struct timespec start;

static void stop(int signal_number) {
    (void)signal_number;
    _exit(EXIT_SUCCESS);
}

static void fail(const char *what) {
    perror(what);
    exit(EXIT_FAILURE);
}

static void open_pty(void) {
    struct termios raw;
    in_fd = out_fd = posix_openpt(O_RDWR | O_NOCTTY);
    if (in_fd < 0 || grantpt(in_fd) != 0 || unlockpt(in_fd) != 0)
        fail("opening a pseudo-terminal");
    /* Stays open here, so that hosts can come and go without an end of input. */
    const int device = open(ptsname(in_fd), O_RDWR | O_NOCTTY);
    if (device < 0 || tcgetattr(device, &raw) != 0)
        fail("opening the device side of the pseudo-terminal");
    raw.c_iflag &= ~(tcflag_t)(BRKINT | ICRNL | IGNCR | INLCR | INPCK | ISTRIP | IXON | IXOFF);
    raw.c_oflag &= ~(tcflag_t)OPOST;
    raw.c_lflag &= ~(tcflag_t)(ECHO | ECHONL | ICANON | IEXTEN | ISIG);
    /* Else it would wait for room for all of what is written. */
    if (tcsetattr(device, TCSANOW, &raw) != 0 || fcntl(out_fd, F_SETFL, O_NONBLOCK) != 0)
        fail("setting the pseudo-terminal to raw");
    printf("%s\n", ptsname(in_fd));
    fflush(stdout);
}

void j2a_port_init(int argc, char **argv) {
    struct sigaction action;
    memset(&action, 0, sizeof action);
    action.sa_handler = stop;
    sigaction(SIGTERM, &action, NULL);
    sigaction(SIGINT, &action, NULL);
    action.sa_handler = SIG_IGN; /* a reader that went away is seen by write() */
    sigaction(SIGPIPE, &action, NULL);
    clock_gettime(CLOCK_MONOTONIC, &start);
    if (argc == 2 && strcmp(argv[1], "--pty") == 0) {
        open_pty();
    } else if (argc > 1) {
        fprintf(stderr, "usage: %s [--pty]\nspeaks J2A on stdin and stdout, or on a new pty\n", argv[0]);
        exit(EXIT_FAILURE);
    }
}

/* Did the last call fail only because it came too early? (The host may have set O_NONBLOCK.) */
static bool again(void) {
    return errno == EAGAIN || errno == EINTR;
}

/* Writes what there is room for, of a pipe PIPE_BUF or none, so that a host that does not read stops nothing else. */
static void flush(void) {
    size_t done = 0;
    while (done < tx_used) {
        struct pollfd output = {out_fd, POLLOUT, 0};
        const size_t most = tx_used - done < PIPE_BUF ? tx_used - done : PIPE_BUF;
        const int ready = poll(&output, 1, 1);
        const ssize_t n = ready > 0 ? write(out_fd, tx + done, most) : ready;
        if (n > 0)
            done += (size_t)n;
        else if (ready == 0)
            j2a_waiting();
        else if (!again())
            exit(EXIT_SUCCESS); /* nobody reads any more */
    }
    tx_used = 0;
}

/* Fills the empty receive buffer with what is there within timeout_ms. */
static void receive(int timeout_ms) {
    struct pollfd input = {in_fd, POLLIN, 0};
    ssize_t n;
    if (at_end || poll(&input, 1, timeout_ms) <= 0)
        return;
    n = read(in_fd, rx, sizeof rx);
    at_end = n == 0 || (n < 0 && !again());
    rx_next = 0;
    rx_used = n > 0 ? (size_t)n : 0;
}

int16_t j2a_port_rx(void) {
    if (rx_next == rx_used)
        receive(0);
    return rx_next == rx_used ? -1 : rx[rx_next++];
}

void j2a_port_tx(uint8_t byte) {
    tx[tx_used++] = byte;
    if (tx_used == sizeof tx)
        flush();
}

void j2a_port_idle(void) {
    flush();
    if (rx_next == rx_used) {
        if (at_end)
            exit(EXIT_SUCCESS);
        receive(1);
    }
}

static uint64_t elapsed_us(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint64_t)((int64_t)(now.tv_sec - start.tv_sec) * 1000000 + (now.tv_nsec - start.tv_nsec) / 1000);
}

#if J2A_WITH_CLOCK
uint64_t j2a_port_time_us(void) {
    return J2A_WITH_SYNC ? crystal_us(elapsed_us()) : elapsed_us();
}
#endif

uint16_t j2a_port_ticks(void) {
    return (uint16_t)(elapsed_us() / (1000 / J2A_TICKS_PER_MS));
}

uint16_t j2a_port_overruns(void) {
    return 0; /* the kernel makes the host wait */
}
