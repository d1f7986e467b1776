"""Sends all values of a byte to a board that sends each one back (firmware/apps/bytes).

python echo_bytes.py URL
"""

import sys
import time

import j2a_transports

if len(sys.argv) != 2:
    sys.exit(f"usage: python {sys.argv[0]} URL")

WAIT_S = 1.0

with j2a_transports.open(sys.argv[1]) as link:
    for value in range(256):
        link.write(bytes((value,)))
        back, end_s = b"", time.monotonic() + WAIT_S
        while not back and time.monotonic() < end_s:
            back = link.read(WAIT_S)
        if back != bytes((value,)):
            sys.exit(f"sent {value:02x}, came back: {back.hex(' ') or 'nothing'}")
print("all 256 bytes came back")
