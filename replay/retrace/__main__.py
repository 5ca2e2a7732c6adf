"""Runs a plan again: ``python -P -m replay.retrace JSON``, from :mod:`.plan_process`."""

import sys

from replay.retrace.process import main

main(sys.argv[1])
