"""``python -m pycram`` is the command ``pycram``."""

import sys

from pycram.cli import main

sys.exit(main())
