"""Make everything in this folder from numbers: the kitchen, the floor and the household objects.

Run ``python resources/make_resources.py`` to write the files beside this script, or ``--into DIR`` to write them
elsewhere. Running it again gives the same bytes. ``make/thing.py`` says which files an object has and how they are to
be loaded.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from make import crockery, cutlery, packages
from make.files import write_text, write_things
from make.floor import floor
from make.kitchen import kitchen

THINGS = (
    packages.milk,
    packages.breakfast_cereal,
    crockery.bowl,
    cutlery.spoon,
    crockery.cup,
    crockery.plate,
    packages.bottle,
    cutlery.fork,
    cutlery.knife,
    crockery.glass,
    crockery.pot,
    packages.apple,
)


def main() -> None:
    """Write all resources."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--into", type=Path, default=Path(__file__).parent, help="folder to write into (default: this script's)"
    )
    folder: Path = parser.parse_args().into
    folder.mkdir(parents=True, exist_ok=True)
    write_text(folder / "kitchen.urdf", kitchen())
    write_text(folder / "plane.urdf", floor())
    write_things([make() for make in THINGS], folder)


if __name__ == "__main__":
    main()
