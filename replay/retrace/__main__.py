"""Runs a plan again: ``python -P -m replay.retrace JSON``, from :mod:`.plan_process`."""

import sys

from replay.retrace.guided_run import main

main(sys.argv[1])
