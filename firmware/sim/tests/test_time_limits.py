"""The time limits of calls to a simulated board are simulated time."""

import asyncio

import pytest
from j2a_sim import AvrSim, SimLink

import j2a
from j2a.cli import main

pytestmark = [pytest.mark.avr, pytest.mark.requirement("J2A-TIME-006")]

THREE_SECONDS = (3000).to_bytes(2, "little")
# Simulated seconds that may pass besides, most of them while a busy machine lets the program wait.
STEPS_S = 0.9


@pytest.fixture
def link(build_firmware):
    with AvrSim(build_firmware("demo", port="avr-serial")) as sim:
        yield SimLink(sim)


def test_a_call_ends_after_its_time_limit(link):
    with j2a.Client(link) as client:
        begun_s = link.clock()
        with pytest.raises(j2a.CallTimeout):
            client.call("delay", THREE_SECONDS, timeout=1.0)
        assert 1.0 <= link.clock() - begun_s < 1.0 + STEPS_S


def test_a_reply_within_the_time_limit_is_taken(link):
    with j2a.Client(link) as client:
        begun_s = link.clock()
        assert client.call("delay", THREE_SECONDS, timeout=9.0).ok
        assert 3.0 <= link.clock() - begun_s < 3.0 + STEPS_S


def test_the_asyncio_client_does_the_same(link):
    async def main():
        async with j2a.AsyncClient(link) as client:
            begun_s = link.clock()
            with pytest.raises(j2a.CallTimeout):
                await client.call("delay", THREE_SECONDS, timeout=1.0)
            assert 1.0 <= link.clock() - begun_s < 1.0 + STEPS_S
            # The board first ends the call that was given up.
            assert (await client.call("delay", THREE_SECONDS, timeout=9.0)).ok
            assert 6.0 <= link.clock() - begun_s < 6.0 + 2 * STEPS_S

    asyncio.run(main())


def test_j2a_watch_counts_simulated_seconds(build_firmware, capsys):
    url = f"sim:{build_firmware('demo', 'avr-serial')}"
    assert main(["watch", url, "--call", "sifPeriod u16:100", "--duration", "2"]) == 0
    assert 18 <= len(capsys.readouterr().out.splitlines()) <= 21
