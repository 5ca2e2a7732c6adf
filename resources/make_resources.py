"""Make everything in this folder from numbers: kitchen, floor, table, gripper and household objects.

Run ``python resources/make_resources.py`` to write the files next to this script; ``--into DIR`` names another folder.
Each run gives the same bytes. ``make/thing.py`` describes the files of an object.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from make import crockery, cutlery, packages
from make.files import write_text, write_things
from make.floor import floor
from make.gripper import two_finger_gripper
from make.kitchen import kitchen
from make.kitchen_names import kitchen_names
from make.table import table

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
    write_text(folder / "kitchen.furniture.toml", kitchen_names())
    write_text(folder / "plane.urdf", floor())
    write_text(folder / "table.urdf", table())
    write_text(folder / "two_finger_gripper.urdf", two_finger_gripper())
    write_things([make() for make in THINGS], folder)


if __name__ == "__main__":
    main()
