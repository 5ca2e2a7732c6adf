"""Runs a plan again: ``python -P -m replay.retrace JSON``, from :mod:`.plan_process`."""

import json
import sys

from replay.retrace.process import main

main(**json.loads(sys.argv[1]))
