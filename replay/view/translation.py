"""A recording on its way through the viewer's translator; what nobody could have written is told as damage.

A long recording goes through two at once: this process translates what is seen, and another what is told of it
(:mod:`replay.view.worker`). Both read all of it, which is the smaller part of the work.
"""

from __future__ import annotations

import contextlib
import os
import zlib
from typing import TYPE_CHECKING, Final

from recorder.records.asset import AssetFile
from recorder.viewer.translator import Half, Translator
from replay.errors import Damaged
from replay.view.worker import Worker

if TYPE_CHECKING:
    from pathlib import Path

    import rerun as rr

    from replay.file.log import Log

_LONG: Final = 50_000  # records, from which on two processes are quicker than one
_NONSENSE: Final = (
    ValueError,
    KeyError,
    TypeError,
    IndexError,
    ArithmeticError,
    AttributeError,
    SyntaxError,
    zlib.error,
)
"""What records raise that nobody could have written; models that are no XML are syntax errors."""


def translated(log: Log, stream: rr.RecordingStream, root: str = "", folder: Path | None = None) -> Translator:
    """Sends all that is shown of a recording.

    Args:
        log: the recording.
        stream: where it goes.
        root: the entity that all others are below; "" for none.
        folder: where there is room for half of it; by default that for temporary files.

    Returns:
        What translated it: it knows the worlds.

    Raises:
        Damaged: a record makes no sense.
        OSError: there is no room.
    """
    worker = None
    if len(log) >= _LONG and os.cpu_count() != 1:
        with contextlib.suppress(OSError):  # as where a process can't begin another; if there is no room, that is told
            worker = Worker(log, root, folder)
    if worker is None:
        translator = Translator(stream, root)
        _see(log, translator)
        return translator
    with worker:
        translator = Translator(stream, root, Half.SEEN)
        _see(log, translator)
        worker.hand_over(stream)
    return translator


def _see(log: Log, translator: Translator) -> None:
    for name in log.assets:
        try:
            with contextlib.suppress(Damaged):  # which the recording remembers; what needs it isn't shown
                translator.attach(AssetFile(name.partition("/")[2], log.assets[name]))
        except _NONSENSE as error:
            raise Damaged(log.path, f"the attached file {name}", f"it makes no sense: {error}") from error
    show(log, translator)
    for name in translator.absent:  # filters of other tools leave attachments out
        log.assets.damaged.setdefault(name, "it isn't there")


def show(log: Log, translator: Translator, stop: int | None = None) -> None:
    """Gives a translator the records of a recording.

    Args:
        log: the recording.
        translator: what shows them.
        stop: the step before which to end; the end by default.

    Raises:
        Damaged: a record makes no sense.
    """
    for record in log.records(stop=stop):
        try:
            translator.show(record)
        except _NONSENSE as error:
            raise Damaged(log.path, f"step {record.seq}", f"it makes no sense: {error}") from error
    try:
        translator.finish()
    except _NONSENSE as error:  # as a time that is longer than any
        raise Damaged(log.path, "a record", f"it makes no sense: {error}") from error
