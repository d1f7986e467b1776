/* Where the drivers are wired, for each chip. In: the chip that the compiler builds for. Out: names of ports,
 * registers and interrupts. Numbers in brackets are those of the Arduino with that chip.
 * Rule: the four wires of the encoders are neighbours in one port whose pins can interrupt. */
#ifndef DRIVER_PINS_H
#define DRIVER_PINS_H

#include <avr/io.h>

#if defined(__AVR_ATmega328P__) || defined(__AVR_ATmega328__) || defined(__AVR_ATmega168__) \
    || defined(__AVR_ATmega168P__)
/* Uno, Nano. Encoders: PD2 (2) A and PD3 (3) B, PD4 (4) A and PD5 (5) B. Servos: PB1 (9), PB2 (10).
 * Lamp: PB5 (13). Analog: ADC0 to ADC3 (A0 to A3). I2C: PC4 (A4) SDA, PC5 (A5) SCL. */
#define QUAD_IN PIND
#define QUAD_OUT PORTD
#define QUAD_SHIFT 2
#define QUAD_vect PCINT2_vect
#define QUAD_MASK PCMSK2
#define QUAD_ENABLE PCIE2
#define SERVO_DDR DDRB
#define SERVO_BIT_A 1
#define SERVO_BIT_B 2
#define LAMP_DDR DDRB
#define LAMP_OUT PORTB
#define LAMP_BIT 5
#define ADC_INPUTS {0, 1, 2, 3}
#define TWI_PORT PORTC
#define TWI_PULL_UPS (_BV(4) | _BV(5))
#elif defined(__AVR_ATmega32U4__) || defined(__AVR_ATmega16U4__)
/* Micro, Leonardo. Encoders: PB0 (SS) A and PB1 (SCK) B, PB2 (MOSI) A and PB3 (MISO) B. Servos: PB5 (9),
 * PB6 (10). Lamp: PC7 (13). Analog: ADC7 to ADC4 (A0 to A3), which are pins of JTAG too: its fuse is off on
 * these boards. I2C: PD1 (2) SDA, PD0 (3) SCL. */
#define QUAD_IN PINB
#define QUAD_OUT PORTB
#define QUAD_SHIFT 0
#define QUAD_vect PCINT0_vect
#define QUAD_MASK PCMSK0
#define QUAD_ENABLE PCIE0
#define SERVO_DDR DDRB
#define SERVO_BIT_A 5
#define SERVO_BIT_B 6
#define LAMP_DDR DDRC
#define LAMP_OUT PORTC
#define LAMP_BIT 7
#define ADC_INPUTS {7, 6, 5, 4}
#define TWI_PORT PORTD
#define TWI_PULL_UPS (_BV(0) | _BV(1))
#elif defined(__AVR_ATmega32U2__) || defined(__AVR_ATmega16U2__)
/* No Arduino of its own. Encoders: PB0 A and PB1 B, PB2 A and PB3 B. Servos: PC6, PC5. Lamp: PD5. It has no
 * ADC and no I2C. */
#define QUAD_IN PINB
#define QUAD_OUT PORTB
#define QUAD_SHIFT 0
#define QUAD_vect PCINT0_vect
#define QUAD_MASK PCMSK0
#define QUAD_ENABLE PCIE0
#define SERVO_DDR DDRC
#define SERVO_BIT_A 6
#define SERVO_BIT_B 5
#define LAMP_DDR DDRD
#define LAMP_OUT PORTD
#define LAMP_BIT 5
#else
#error "drivers/avr/pins.h does not know this chip: add its pins there"
#endif

#endif
