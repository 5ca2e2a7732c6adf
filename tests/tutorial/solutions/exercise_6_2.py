from scene import build

from pycram import perform
from pycram.action_designators import transporting

with build() as world:
    milk = world.get_object("milk")
    perform(transporting(object=milk, target=[-0.8, 1.0, 0.95]))
    x, y, z = milk.get_position()
    perform(transporting(object="bowl", target=[x, y - 0.3, z - 0.06]))
