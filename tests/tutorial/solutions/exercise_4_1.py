from scene import build

from pycram import perform
from pycram.action_designators import transporting
from pycram.designator import LocationDesignator

with build() as world:
    milk = perform(transporting(object="milk", target="island"))
    perform(transporting(object="bowl", target=LocationDesignator(on="island", near=milk)))
