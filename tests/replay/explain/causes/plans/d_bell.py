"""Serves when the bell has rung."""

from household import kitchen, perform

from pycram.event import Event
from pycram.fluent import Fluent
from pycram.language import par, timeout

world = kitchen(bowl=[1.35, 0.9, 0.89])
bell = Event("bell")
rung = Fluent(None, "bell_rung")


def on_bell():
    rung.set_value(True)


def await_bell():
    with timeout(0.3):
        rung.wait_for()  # @wait


bell += on_bell
with par as s:
    s(perform, type="pick-up", object=world.get_object("bowl"), arm="left")
    s(await_bell)
perform(type="move-arm-joints", right_arm="park")
