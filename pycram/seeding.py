"""Seeds of a run: random numbers, and the order of sets, which Python takes from its environment when it starts.

So a command that runs a plan starts itself again, once, with ``PYTHONHASHSEED`` set to the seed.
"""

from __future__ import annotations

import argparse
import os
import random
import sys
from contextlib import suppress
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Sequence

MAX_SEED: Final = 2**32 - 1  # of PYTHONHASHSEED and of NumPy

_HASH: Final = "PYTHONHASHSEED"
#: Set by :func:`restart`: the process that was started again, which a plan's own processes are not, and its seed.
_RESTARTED: Final = "PYCRAM_SEEDED"


def chosen_seed(given: int | None) -> int:
    """Return a run's seed: the one that is given, else that of the user's ``PYTHONHASHSEED``, else a drawn one."""
    if given is not None:
        return given
    process, _, inherited = os.environ.get(_RESTARTED, "").partition(":")
    text = os.environ.get(_HASH, "")
    chosen_by_run = text == inherited and process != str(os.getpid())  # of a plan that has started this process
    if text.isdecimal() and int(text) <= MAX_SEED and not chosen_by_run:
        return int(text)
    return random.SystemRandom().randrange(MAX_SEED + 1)


def restart(seed: int) -> None:
    """Start this command again, in this process, with the order of sets that belongs to a seed, unless it has it."""
    mark = f"{os.getpid()}:{seed}"
    if os.environ.get(_RESTARTED) == mark or sys.flags.ignore_environment:
        return
    if os.environ.get(_HASH) == str(seed) and (sys.flags.hash_randomization or not seed):
        return
    environment = os.environ | {_HASH: str(seed), _RESTARTED: mark}
    os.execve(sys.executable, [sys.executable, *sys.orig_argv[1:]], environment)  # noqa: S606  this very command


def restart_early(words: Sequence[str]) -> None:
    """Start a command that runs a plan again before it has imported what takes longer than all else that it does.

    What can't be understood yet is left to :func:`restart`, when all words are parsed.

    Args:
        words: The command's, as they were typed.
    """
    done = os.environ.get(_RESTARTED, "").startswith(f"{os.getpid()}:")
    if done or words[:1] not in (["run"], ["demo"], ["sweep"]):
        return
    own = words[: words.index("--")] if "--" in words else words
    parser = argparse.ArgumentParser(add_help=False, exit_on_error=False)
    parser.add_argument("--seed")
    with suppress(argparse.ArgumentError):
        text = parser.parse_known_args(own)[0].seed
        text = "0" if text is None and words[0] == "sweep" else text  # its default
        if text is None or (text.isdecimal() and int(text) <= MAX_SEED):
            restart(chosen_seed(None if text is None else int(text)))


def seed_random_numbers(seed: int | None) -> None:
    """Seed Python's and NumPy's random numbers, but for generators of one's own; None leaves them as they are."""
    if seed is None:
        return
    import numpy as np  # noqa: PLC0415  heavy: not before the command starts itself again

    random.seed(seed)
    np.random.seed(seed)  # noqa: NPY002  plans may use the old interface
