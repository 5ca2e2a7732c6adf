"""One branch tidies up, the other waits for the guests to leave."""

from household import kitchen, perform

from pycram.fluent import Fluent
from pycram.language import par

world = kitchen(cup=[1.35, 0.9, 0.9])
guests = Fluent(4, "guests")


def wait_for_guests():
    print("waiting for guests", flush=True)
    (guests == 0).wait_for()  # @cause


with par as s:
    s(perform, type="pick-up", object=world.get_object("cup"), arm="left")
    s(wait_for_guests)
