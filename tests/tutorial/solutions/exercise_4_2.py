from scene import build

from pycram import perform
from pycram.action_designators import transporting

with build() as world:
    perform(transporting(object="spoon", target="island"))
