"""The TWI of a simulated chip: what its status says of who answers, and who does not."""

import pytest

pytestmark = pytest.mark.avr

TWSR, TWDR, TWCR = 0xB9, 0xBB, 0xBC
TWINT, TWSTA, TWSTO, TWEN = 0x80, 0x20, 0x10, 0x04
START, ADDRESS_ACK, ADDRESS_NACK, DATA_ACK, DATA_NACK = 0x08, 0x18, 0x20, 0x28, 0x30
READ_ADDRESS_ACK, READ_ADDRESS_NACK = 0x40, 0x48
SRF02 = 0x70


@pytest.fixture
def ask(open_chip):
    """ask(address, *data, read=False) sends bytes; returns the status behind each of them."""
    chip = open_chip("atmega32u4")

    def step(control):
        chip.put(TWCR, TWINT | TWEN | control)
        while not chip.get(TWCR) & TWINT:
            pass
        return chip.get(TWSR) & 0xF8

    def send(address, *data, read=False):
        assert step(TWSTA) == START
        seen = []
        for byte in (address << 1 | read, *data):
            chip.put(TWDR, byte)
            seen.append(step(0))
        chip.put(TWCR, TWINT | TWEN | TWSTO)
        return seen

    send.twi = chip.sim.twi
    return send


def test_the_status_tells_the_address_from_what_follows(ask):
    ask.twi.set_distance(SRF02, 123)
    assert ask(SRF02, 0, 0x51) == [ADDRESS_ACK, DATA_ACK, DATA_ACK]


@pytest.mark.parametrize("address", [0x05, SRF02])
@pytest.mark.parametrize("read", [False, True])
def test_nobody_answers(ask, address, read):
    assert ask(address, read=read) == [READ_ADDRESS_NACK if read else ADDRESS_NACK]
    ask.twi.set_distance(SRF02, 1)
    ask.twi.remove(SRF02)
    assert ask(address, read=read) == [READ_ADDRESS_NACK if read else ADDRESS_NACK]


def test_one_that_is_deaf(ask):
    ask.twi.deafen(SRF02)
    assert ask(SRF02, 0) == [ADDRESS_ACK, DATA_NACK]
    assert ask(SRF02, read=True) == [READ_ADDRESS_ACK]
