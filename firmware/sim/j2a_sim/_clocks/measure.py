"""Measures the delays of a board in simavr: `python -m j2a_sim._clocks.measure`.

In: the real firmware. Out: board_delays.json beside this module, quantiles in microseconds, from
which
the native engine draws:
    sof          from the start of a frame to the reading of the counter in its interrupt
    usb_out      from the submission of a request to the end of its packet
    usb_turn     from there to the received time, for which the main loop has to come round
    control_out  from the submission of the request of SyncUSB to what the board tells of it
    control_in   from there to the end of the transfer
    usb_in       from the end of the turnaround to the end of the packet of the reply
    serial_turn  from the end of the last byte of a request to the received time
    serial_reply from the end of the turnaround to the start bit of the reply
    reading      what one reading of the counter takes, a third of the turnaround
Rules: the true times are cycles of the simulator; requests come at random times between frames.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Final

import numpy as np
from j2a_spec.constants import SOF

from j2a.events import Frame
from j2a.protocol.clock import Exchange, pack_exchange, unpack_exchange
from j2a.protocol.codec import encode
from j2a.protocol.deframer import Deframer
from j2a_sim._clocks.avr import FREQUENCY_HZ, AvrBoard, build_firmware
from j2a_sim._clocks.delays import BOARD_BYTE_S, HOST_BYTE_S, SHARES, quantiles
from j2a_sim._clocks.frames import Bus
from j2a_sim._clocks.host import clock_opcode
from j2a_sim._clocks.truth import Oscillator
from j2a_sim._errors import SimError

US: Final = FREQUENCY_HZ / 1e6
ROUNDS: Final = 1500
SECONDS: Final = 60.0
GEN_VECTOR: Final = 10  # USB_GEN of an ATmega32U4
FILE: Final = Path(__file__).parent / "board_delays.json"
Found = dict[str, list[float]]


def _board(link: str) -> AvrBoard:
    rng = np.random.default_rng(1)
    exact = Oscillator(np.zeros(100))
    frames = Bus(rng, SECONDS, exact, 0.0).at_board(rng, 0.0, 0.0) if link == "usb" else None
    return AvrBoard(
        build_firmware(link),
        rng=rng,
        oscillator=exact,
        frames=frames,
        link=link,
        times_s=np.zeros(0),
    )


def _exchange(board: AvrBoard, at_s: float, opcode: int) -> tuple[Exchange, int, int]:
    """Make an exchange; returns it, and the lengths of both frames on the wire."""
    frame = encode(SOF, 1, opcode, pack_exchange(1))
    answer = board.call(at_s, frame)
    replies = [] if answer is None else Deframer().feed(answer[0])
    if answer is None or not replies or not isinstance(replies[-1], Frame):
        raise SimError("a board did not answer an exchange")
    return unpack_exchange(replies[-1].payload, 1, 0.0, 1e6), len(frame), len(answer[0])


def measure_usb() -> Found:
    """Measure a board on a USB."""
    board, rng = _board("usb"), np.random.default_rng(2)
    sim, now_s = board.sim, 1.0
    opcode, _ = clock_opcode(board, now_s)
    found: Found = {name: [] for name in ("sof", "usb_out", "usb_turn", "usb_in", "reading")}
    late: list[float] = []
    read: list[float] = []
    for _ in range(ROUNDS):
        now_s += rng.uniform(0.011, 0.013)
        board.run(now_s)
        board.ends.clear()
        submitted = sim.cycle
        exchange, _, _ = _exchange(board, now_s, opcode)
        received = board.memory.cycle(exchange.received_us)
        made = received + exchange.turnaround_us * US
        (out, _), *_, (back, _) = board.ends
        found["usb_out"].append((out - submitted) / US)
        found["usb_turn"].append(max(0.0, (received - out) / US))
        found["usb_in"].append(max(0.0, (back - made) / US))
        found["reading"].append(exchange.turnaround_us / 3)
        # The frame that begins while the board is busy with the next request, and its interrupt.
        wanted = sim.usb.frame_start + sim.usb.frame_cycles
        sim.run(int(wanted - rng.uniform(0, 300 * US)) - sim.cycle)
        sim.usb.submit_out(board.out_address, encode(SOF, 2, opcode, pack_exchange(2)))
        sim.run(int(wanted) - sim.cycle)
        sim.clear_interrupts()
        sim.run(int(200 * US))
        late.append(sim.interrupts(GEN_VECTOR).latest_cycles / US)
        read.append((board.memory.captured() - sim.usb.frame_start) / US)
        board.run(board.true_s(sim.cycle) + 0.003)
        board.take()
        now_s = board.true_s(sim.cycle)
    # The counter ticks each half microsecond: what lies between two ticks is known on average only.
    steady = float(np.mean(np.array(read) + 0.25 - np.array(late)))
    found["sof"] = [steady + value for value in late]
    return found


def measure_control() -> Found:
    """Measure the request of SyncUSB."""
    board, rng = _board("usb"), np.random.default_rng(4)
    now_s = 1.0
    found: Found = {"control_out": [], "control_in": []}
    for _ in range(ROUNDS):
        now_s += rng.uniform(0.011, 0.013)
        board.run(now_s)
        submitted = board.sim.cycle
        _, age_us, came_s = board.frame_seen(now_s)
        # Whole microseconds are told, and the counter ticks each half.
        told = board.memory.captured() + (age_us + 0.5) * US
        if told > board.ends[-1][0]:  # a frame has begun since
            told -= board.sim.usb.frame_cycles
        found["control_out"].append(max(0.0, (told - submitted) / US))
        found["control_in"].append(max(0.0, (board.ends[-1][0] - told) / US))
        now_s = came_s
    return found


def measure_serial() -> Found:
    """Measure a board at 115200 baud."""
    board, rng = _board("serial"), np.random.default_rng(3)
    now_s = 1.0
    opcode, _ = clock_opcode(board, now_s)
    found: Found = {"serial_turn": [], "serial_reply": []}
    for _ in range(ROUNDS):
        now_s += rng.uniform(0.011, 0.013)
        board.run(now_s)
        began = board.sim.cycle
        exchange, sent, came = _exchange(board, now_s, opcode)
        received = board.memory.cycle(exchange.received_us)
        arrived = began + sent * HOST_BYTE_S * FREQUENCY_HZ
        made = received + exchange.turnaround_us * US
        # The host has a byte in the middle of its stop bit.
        start = board.ends[-1][0] - (came - 0.05) * BOARD_BYTE_S * FREQUENCY_HZ
        found["serial_turn"].append(max(0.0, (received - arrived) / US))
        found["serial_reply"].append(max(0.0, (start - made) / US))
        now_s = board.true_s(board.sim.cycle)
    return found


def main() -> int:
    """Measure and write the file."""
    rows: dict[str, object] = {
        "about": "microseconds at these shares; see measure.py",
        "shares": list(SHARES),
    }
    for name, values in {**measure_usb(), **measure_serial(), **measure_control()}.items():
        rows[name] = quantiles(values)
    text = ",\n".join(f"{json.dumps(key)}: {json.dumps(value)}" for key, value in rows.items())
    FILE.write_text(f"{{\n{text}\n}}\n", "utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
