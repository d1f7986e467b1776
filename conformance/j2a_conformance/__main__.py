"""`python -m j2a_conformance` is `j2a-conform`."""

import sys

from .cli import main

sys.exit(main())
