"""Keep the clock of a board right, and see how right it is: python clock.py URL."""

import sys
import time

import j2a

if len(sys.argv) != 2:
    sys.exit(f"usage: python {sys.argv[0]} URL")

with j2a.connect(sys.argv[1]) as board, board.clock.discipline():
    for _ in range(3):
        time.sleep(1.0)
        now = board.clock.read()
        print(f"{now.state}: off by {now.offset_us:+.0f} us, known to {now.uncertainty_us:.0f} us")
