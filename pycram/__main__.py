"""Run the command ``pycram`` as ``python -m pycram``."""

import sys

from pycram.cli import main

if __name__ == "__main__":
    sys.exit(main())
