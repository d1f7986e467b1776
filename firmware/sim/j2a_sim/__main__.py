"""`python -m j2a_sim avr ELF` is `j2a sim avr ELF`."""

import sys

from j2a.cli import main

sys.exit(main(["sim", *sys.argv[1:]]))
