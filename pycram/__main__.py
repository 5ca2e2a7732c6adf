"""``python -m pycram`` is the command ``pycram``."""

import sys

from pycram.seeding import restart_early


def main() -> int:
    """Run the command with the process' arguments, and return its exit code; see :func:`pycram.cli.main`."""
    restart_early(sys.argv[1:])
    from pycram import cli  # noqa: PLC0415  takes long

    return cli.main()


if __name__ == "__main__":
    sys.exit(main())
