/* A stand-in for the wheel: a signal each millisecond. Included by pulses.c alone. */
#include <signal.h>
#include <string.h>
#include <sys/time.h>

static void each_millisecond(void (*handler)(int)) {
    const struct itimerval period = {{0, 1000}, {0, 1000}};
    struct sigaction action;
    memset(&action, 0, sizeof action);
    action.sa_handler = handler;
    action.sa_flags = SA_RESTART;
    sigaction(SIGALRM, &action, NULL);
    setitimer(ITIMER_REAL, &period, NULL);
}
