/* Runs programs that break out of every memory, on every chip of simavr; test_wild_firmware.py reads it.
 *
 * In:  the result file, then from stdin lines "SEED CYCLES WORDS..." with machine code in hexadecimal.
 *      SEED 0: only that code; else the data space from 0x20 on is first written with random values.
 * Out: for each chip a line with its name and a letter for each program: state after it.
 */
#include "simavr_shim.c"

/* As in simavr's sim_core_decl.h, which is not installed. */
typedef struct {
    const char *names[4];
    avr_t *(*make)(void);
} kind_t;
extern kind_t *avr_kind[];

enum { PROGRAMS = 16384, WORDS = 24, LINE = 512 };
static struct { unsigned seed, cycles, count; uint16_t words[WORDS]; } programs[PROGRAMS];

static unsigned read_programs(void)
{
    char line[LINE];
    unsigned n = 0;
    while (n < PROGRAMS && fgets(line, sizeof line, stdin)) {
        char *at = line;
        programs[n].seed = strtoul(at, &at, 10);
        programs[n].cycles = strtoul(at, &at, 10);
        for (char *end; programs[n].count < WORDS; at = end) {
            unsigned long word = strtoul(at, &end, 16);
            if (end == at)
                break;
            programs[n].words[programs[n].count++] = word;
        }
        n++;
    }
    return n;
}

static uint32_t random_state;
static uint8_t random_byte(void)
{
    random_state = random_state * 1664525 + 1013904223;
    return random_state >> 24;
}

/* ldi r16, value; sts 0x20 + random, r16; a hundred times; then the program. */
static unsigned place(uint8_t *flash, unsigned program)
{
    unsigned at = 0;
    uint16_t words[400 + WORDS];
    random_state = programs[program].seed;
    for (int i = 0; programs[program].seed && i < 100; i++) {
        uint8_t value = random_byte();
        words[at++] = 0xe000 | (value & 0xf0) << 4 | (value & 15);
        words[at++] = 0x9300;
        words[at++] = 0x20 + (random_byte() | (random_byte() & 1) << 8) % 0x118;
    }
    memcpy(words + at, programs[program].words, sizeof programs[program].words);
    at += programs[program].count;
    for (unsigned i = 0; i < at; i++) {
        flash[2 * i] = words[i];
        flash[2 * i + 1] = words[i] >> 8;
    }
    return 2 * at;
}

static void run_all(const char *mcu, unsigned count, FILE *result)
{
    static const uint8_t serial[SIGNATURE_SERIAL];
    char error[256];
    uint8_t rjmp[] = {0xff, 0xcf};
    sim_t *s = sim_new(mcu, 8000000, 0, 0, rjmp, sizeof rjmp, 0x80, serial, error, sizeof error);
    if (!s) {
        fprintf(result, "%s - %s\n", mcu, error);
        return;
    }
    fprintf(result, "%s ", mcu);
    for (unsigned i = 0; i < count; i++) {
        memset(s->avr->flash, 0xff, s->avr->flashend + 1);
        place(s->avr->flash, i);
        sim_reset(s);
        sim_run(s, programs[i].cycles, 0);
        fputc(s->illegal ? 'i' : "lsrzttdc"[s->avr->state], result);
    }
    fputc('\n', result);
    sim_free(s);
}

int main(int argc, char **argv)
{
    FILE *result = argc == 3 ? fopen(argv[1], "w") : NULL;
    if (!result)
        return 2;
    unsigned count = read_programs();
    int odd = atoi(argv[2]), chip = 0; /* every second chip, so that two processes share them */
    for (kind_t **kind = avr_kind; *kind; kind++)
        if (strcmp((*kind)->names[0], "atmega16m1") && chip++ % 2 == odd)
            run_all((*kind)->names[0], count, result);
    for (unsigned i = 0; mcu_relative(i); i++)
        if (chip++ % 2 == odd)
            run_all(mcu_relative(i), count, result);
    return fclose(result) != 0;
}
