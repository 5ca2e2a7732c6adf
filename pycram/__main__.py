"""``python -m pycram`` is the command ``pycram``."""

import sys

from pycram.cli import main

if __name__ == "__main__":
    sys.exit(main())
