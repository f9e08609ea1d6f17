"""``python -m torchrender``: the command `torchrender`."""

import sys

from .cli import main

sys.exit(main())
