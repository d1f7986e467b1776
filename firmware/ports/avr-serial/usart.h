/* The names of the USART's registers and interrupts: those of USART number J2A_USART, which is 0 unless
 * the chip has none of that number (ATmega32U4). */
#ifndef USART_H
#define USART_H

#include <avr/io.h>

#if !(defined UCSR0C || defined UCSR1C) || !defined TIMSK1
#error "this chip has no USART of the newer kind, or no timer 1; see firmware/README.md"
#endif

#ifndef J2A_USART
#ifdef UBRR0
#define J2A_USART 0
#else
#define J2A_USART 1
#endif
#endif

#define USART_PASTE(before, number, after) before##number##after
#define USART_NAME(before, number, after) USART_PASTE(before, number, after)

#define UBRRnL USART_NAME(UBRR, J2A_USART, L)
#define UBRRnH USART_NAME(UBRR, J2A_USART, H)
#define UCSRnA USART_NAME(UCSR, J2A_USART, A)
#define UCSRnB USART_NAME(UCSR, J2A_USART, B)
#define UCSRnC USART_NAME(UCSR, J2A_USART, C)
#define UDRn USART_NAME(UDR, J2A_USART, )

#ifdef USART_RX_vect /* chips with one USART do not number it */
#define USARTn_RX_vect USART_RX_vect
#else
#define USARTn_RX_vect USART_NAME(USART, J2A_USART, _RX_vect)
#endif

/* Bits of the registers, at the same place in every USART. */
enum {
    BIT_U2X = 1,
    BIT_DOR = 3,
    BIT_UDRE = 5,
    BIT_8N1 = 1 << 1 | 1 << 2, /* the value of UCSRnC */
    BIT_TXEN = 3,
    BIT_RXEN = 4,
    BIT_RXCIE = 7
};

#endif
