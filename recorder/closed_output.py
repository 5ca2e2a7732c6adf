"""Output that nobody reads any more, as after ``| head``: the rest of it is discarded, which is no error."""

from __future__ import annotations

import io
import os
import sys
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator
    from typing import TextIO


@contextmanager
def until_closed() -> Iterator[None]:
    """Passes on what its block prints; where nobody reads it any more, the block ends there, without an error."""
    try:
        yield
    except BrokenPipeError:
        pass
    finally:
        for stream in filter(None, (sys.stdout, sys.stderr)):
            try:
                stream.flush()
            except BrokenPipeError:
                discard(stream)


def discard(stream: TextIO) -> None:
    """Lets a stream lead to nowhere, with what is still in its buffer: else Python complains of that as it ends."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    with suppress(AttributeError, io.UnsupportedOperation):  # a stream that a plan has put there
        os.dup2(nowhere, stream.fileno())
    os.close(nowhere)
