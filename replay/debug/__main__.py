"""Runs a plan to debug it: ``python -P -m replay.debug JSON``, from :mod:`.guided_plan`."""

import sys

from replay.debug.stopped_plan import main

main(sys.argv[1])
