/* Constants in flash. In: the address of an object declared J2A_FLASH. Out: its bytes. On a
 * Harvard machine (AVR) such objects need their own load instruction; elsewhere they are plain
 * constants. j2a_flash_load() reads the first bytes of one into another of its type, or all. */
#ifndef J2A_PROGMEM_H
#define J2A_PROGMEM_H

#include <stdint.h>

/* Of a definition that another one may replace, as that of a2j.h does. */
#ifdef __GNUC__
#define J2A_WEAK __attribute__((weak))
#else
#define J2A_WEAK
#endif

/* Of a function in a header. SDCC keeps a static one that nobody calls. */
#ifdef __SDCC
#define J2A_INLINE inline
#else
#define J2A_INLINE static inline
#endif

#ifdef __AVR__
#define J2A_KEEP_POINTER(pointer) __asm__("" : "+b"(pointer))
#define J2A_NOINLINE __attribute__((noinline))
#define J2A_ALWAYS_INLINE static inline __attribute__((always_inline))
#include <avr/pgmspace.h>
#define J2A_FLASH PROGMEM
#define j2a_flash_u8(address) pgm_read_byte(address)
#define j2a_flash_pointer(address) ((const char *)pgm_read_word(address))
#define j2a_flash_function(address) ((void (*)(void))pgm_read_word(address))
#define j2a_flash_load(to, from, bytes) ((void)memcpy_P((to), (from), (bytes)))
#else
#define J2A_KEEP_POINTER(pointer) ((void)0)
#define J2A_NOINLINE
#define J2A_ALWAYS_INLINE J2A_INLINE
#define J2A_FLASH
#define j2a_flash_u8(address) (*(const uint8_t *)(address))
#define j2a_flash_pointer(address) (*(address))
#define j2a_flash_function(address) (*(address))
#define j2a_flash_load(to, from, bytes) ((void)(*(to) = *(from)))
#endif

#endif
