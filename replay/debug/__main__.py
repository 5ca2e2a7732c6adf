"""Runs a plan to debug it: ``python -P -m replay.debug JSON``, from :mod:`.copies`."""

import json
import sys

from replay.debug.process import main

main(**json.loads(sys.argv[1]))
