"""`python -m j2a` is the command line `j2a`."""

import sys

from j2a.cli import main

sys.exit(main())
