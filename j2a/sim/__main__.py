"""`python -m j2a.sim avr ELF`: the simulator without the rest of the command line."""

from __future__ import annotations

import argparse
import sys

from j2a.sim._command import add_arguments, main

parser = argparse.ArgumentParser(prog="python -m j2a.sim", description="Simulated devices.")
add_arguments(parser)
sys.exit(main(parser.parse_args()))
