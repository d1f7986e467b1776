/* A host on simavr's own model of the USB controller, which has no wire. Arguments: MCU, flash image, LENGTH,
 * length of the configuration descriptor. Prints the two descriptors in hexadecimal, and what endpoint 1
 * makes of LENGTH bytes for endpoint 2. An independent look at firmware that runs on ours. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "avr_usb.h"
#include "sim_avr.h"

static avr_t *avr;
static int attached;

static void on_attach(struct avr_irq_t *irq, uint32_t value, void *param)
{
    (void)irq;
    (void)param;
    attached = value;
}

static void no_sleep(avr_t *a, avr_cycle_count_t cycles)
{
    (void)a;
    (void)cycles;
}

static void run(avr_cycle_count_t cycles)
{
    for (avr_cycle_count_t end = avr->cycle + cycles; avr->cycle < end;)
        avr_run(avr);
}

/* Repeats a transaction until it is not refused; returns its bytes. An IN without data comes back empty. */
static unsigned transact(uint32_t what, int pipe, uint8_t *data, unsigned length, int want_data)
{
    for (int i = 0; i < 10000; i++, run(500)) {
        struct avr_io_usb packet = {pipe, length, data};
        int result = avr_ioctl(avr, what, &packet);
        if (result == AVR_IOCTL_USB_STALL)
            break;
        if (result == AVR_IOCTL_USB_OK && (packet.sz || !want_data))
            return packet.sz;
    }
    fprintf(stderr, "endpoint %d refuses\n", pipe);
    exit(1);
}

static unsigned control(uint8_t type, uint8_t request, unsigned value, unsigned length, uint8_t *to)
{
    uint8_t setup[8] = {type, request, value & 255, value >> 8, 0, 0, length & 255, length >> 8};
    unsigned got = 0, part = 64;
    transact(AVR_IOCTL_USB_SETUP, 0, setup, 8, 0);
    run(4000);
    while (type & 0x80 && got < length && part == 64) {
        part = transact(AVR_IOCTL_USB_READ, 0, to + got, 64, 1);
        got += part;
        run(4000);
    }
    transact(type & 0x80 ? AVR_IOCTL_USB_WRITE : AVR_IOCTL_USB_READ, 0, setup, type & 0x80 ? 0 : 64, 0);
    run(20000);
    return got;
}

static void print(const uint8_t *data, unsigned length)
{
    for (unsigned i = 0; i < length; i++)
        printf("%02x", data[i]);
    printf("\n");
}

int main(int argc, char **argv)
{
    static uint8_t flash[32768], data[512];
    FILE *image = argc == 5 ? fopen(argv[2], "rb") : NULL;
    avr = image ? avr_make_mcu_by_name(argv[1]) : NULL;
    if (!avr)
        return 2;
    size_t size = fread(flash, 1, sizeof flash, image);
    avr_init(avr);
    avr->frequency = 16000000;
    avr->sleep = no_sleep;
    avr_loadcode(avr, flash, size, 0);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_USB_GETIRQ(), USB_IRQ_ATTACH), on_attach, NULL);
    avr_ioctl(avr, AVR_IOCTL_USB_VBUS, (void *)1);
    for (int i = 0; i < 1000 && !attached; i++)
        run(1000);
    avr_ioctl(avr, AVR_IOCTL_USB_RESET, NULL);
    run(160000);
    print(data, control(0x80, 6, 0x0100, 18, data));
    control(0x00, 5, 7, 0, data);
    print(data, control(0x80, 6, 0x0200, atoi(argv[4]), data));
    control(0x00, 9, 1, 0, data);
    unsigned length = atoi(argv[3]);
    for (unsigned i = 0; i < length; i++)
        data[i] = 3 * i;
    transact(AVR_IOCTL_USB_WRITE, 2, data, length, 0);
    memset(data, 0, sizeof data);
    print(data, transact(AVR_IOCTL_USB_READ, 0x81, data, 64, 1));
    return 0;
}
