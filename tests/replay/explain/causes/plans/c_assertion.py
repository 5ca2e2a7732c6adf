"""Counts before it begins."""

from household import kitchen, perform

world = kitchen(cup=[1.35, 0.9, 0.9], glass=[1.35, 0.6, 0.915])


def count(kind):
    return len(world.get_objects_by_type(kind))


def main():
    perform(type="looking", object=world.get_object("cup"))
    assert count("cup") == count("plate")  # @cause
    perform(type="pick-up", object=world.get_object("cup"), arm="left")


main()
