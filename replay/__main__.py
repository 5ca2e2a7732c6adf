"""``python -m replay`` is the command ``pycram-replay``."""

import sys

from replay.cli.main import main

sys.exit(main())
