"""A host program: what a client can do. Takes the URL of a device with the demo functions."""

import struct
import sys

import j2a

with j2a.connect(sys.argv[1]) as board:
    print(board.properties["name"], "has", ", ".join(board.functions))

    reply = board.call("add", struct.pack("<ii", 40, 2), timeout=0.5)
    print("40 + 2 =", struct.unpack("<i", reply.payload)[0])

    board.write_many("store", b"more than a frame holds " * 10)
    print("stored", len(board.read_many("store")), "bytes")

    board.on_sif(0x20, lambda sif: print("the board says", sif.payload.hex()))
    board.call("sif", b"\x20hello")
