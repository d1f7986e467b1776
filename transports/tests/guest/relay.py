"""Carries bytes between two transports: a board of the guest and a program of the host.

In: as a program, the name of a link (see links.py) and a TCP port of the host, to which it connects
when the board is open, and so again and again.  Out: bytes, unchanged, as they come.
Rules: when one side ends, so does the other; the program ends when the host does not answer.
"""

import contextlib
import sys
import threading

import j2a_transports
from j2a_transports import OpenFailed, Transport, TransportError


def join(one: Transport, other: Transport) -> None:
    """Carry bytes both ways until one side ends; then both are closed."""

    def carry(source: Transport, target: Transport) -> None:
        with contextlib.suppress(TransportError):
            while data := source.read(None):
                target.write(data)
        # What was written before still reaches the other side.
        target.close()

    with one, other:
        back = threading.Thread(target=carry, args=(other, one))
        back.start()
        carry(one, other)
        back.join()


def main() -> None:
    from links import HOST, link  # noqa: PLC0415 - there in the guest only

    name, port = sys.argv[1:]
    with link(name) as way:
        while True:
            with j2a_transports.open(way.url) as board:
                try:
                    program = j2a_transports.open(f"tcp://{HOST}:{port}")
                except OpenFailed:
                    return
                join(board, program)


if __name__ == "__main__":
    main()
