from scene import build

import pycram
from pycram import perform
from pycram.action_designators import transporting

given = pycram.parameters(arm="left")

with build() as world:
    perform(transporting(object="milk", target="island", arm=given.arm))
