"""A host program: what a client can do. Takes the URL of a device with the demo functions."""

import sys

import j2a

if len(sys.argv) != 2:
    sys.exit(f"usage: python {sys.argv[0]} URL")

with j2a.connect(sys.argv[1]) as board:
    print(board.properties["name"], "has", ", ".join(board.functions))

    print("40 + 2 =", board.functions.add(40, 2))

    board.write_many("store", b"more than a frame holds " * 10)
    print("stored", len(board.read_many("store")), "bytes")

    with board.sifs("counter") as counters:
        board.functions.sifPeriod(10)
        print("the board counts", [counters.wait(1.0).values.count for _ in range(3)])
        board.functions.sifPeriod(0)
