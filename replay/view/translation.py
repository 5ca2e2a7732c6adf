"""Translates recordings for the viewer, alone or side by side; records that make no sense are reported as damage."""

from __future__ import annotations

import contextlib
import zlib
from typing import TYPE_CHECKING, Final

from recorder.records.asset import AssetFile
from recorder.viewer.active_worlds import acts
from recorder.viewer.blueprint import ORIGIN, blueprint, side_by_side
from recorder.viewer.translator import Translator
from replay.errors import Damaged

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    import rerun as rr

    from recorder.geometry import Vector
    from replay.file.record_reader import RecordReader

_NO_ROOT: Final = ""  # of a recording that is shown alone
_NONSENSE: Final = (
    ValueError,
    KeyError,
    TypeError,
    IndexError,
    ArithmeticError,
    AttributeError,
    SyntaxError,  # of models that are no XML
    zlib.error,
)
"""Errors of translating records that no recorder has written."""


def translate(logs: Sequence[RecordReader], stream: rr.RecordingStream, at: int | None = None) -> None:
    """Sends recordings to a viewer, several side by side; the step ``at`` is looked at first.

    Raises:
        Damaged: a record makes no sense.
    """
    if len(logs) == 1:  # the plan's name, as while it ran
        stream.send_recording_name(logs[0].metadata.get("plan", logs[0].path.name))
    else:
        stream.send_recording_name(" and ".join(log.path.name for log in logs))
    roots = dict(zip(_roots(logs), logs, strict=True))
    fronts = {root: front_world(log, at) for root, log in roots.items()}
    _lay_out(stream, {root: {front: ORIGIN} if front else {} for root, front in fronts.items()}, fronts)
    _lay_out(stream, {root: _translated(log, stream, root) for root, log in roots.items()}, fronts)


def front_world(log: RecordReader, at: int | None = None) -> str:
    """The world that is looked at: that of a step, by default the first that the plan acts in; "" if none.

    Steps without a world of their own are of that of the step before.
    """
    if at is not None:
        world = next((record.world for record in log.backwards(min(at, len(log) - 1)) if record.world), "")
        if world:
            return world
    return next((record.world for record in log if acts(record)), "")


def _roots(logs: Sequence[RecordReader]) -> list[str]:
    """Root entities of recordings that are shown side by side: names of their files, if these are different."""
    if len(logs) == 1:
        return [_NO_ROOT]
    names = [log.path.stem for log in logs]
    return names if len(set(names)) == len(names) else [f"{number}_{name}" for number, name in enumerate(names, 1)]


def _lay_out(
    stream: rr.RecordingStream, recordings: Mapping[str, Mapping[str, Vector]], fronts: Mapping[str, str]
) -> None:
    if _NO_ROOT in recordings:
        stream.send_blueprint(blueprint(recordings[_NO_ROOT], fronts[_NO_ROOT]))
    else:
        stream.send_blueprint(side_by_side(recordings, fronts))


def _translated(log: RecordReader, stream: rr.RecordingStream, root: str) -> Mapping[str, Vector]:
    """Sends a recording, and returns the centres of its worlds in m."""
    translator = Translator(stream, root)
    for name in log.assets:
        with _damage(log, f"the attached file {name}"), contextlib.suppress(Damaged):  # the recording remembers it
            translator.attach(AssetFile(name.partition("/")[2], log.assets[name]))
    for record in log.records():
        try:  # quicker than a context manager for each record
            translator.show(record)
        except _NONSENSE as error:
            raise _nonsense(log, f"step {record.seq}", error) from error
    with _damage(log, "a record"):  # as a time that is longer than any
        translator.finish()
    for name in translator.scene.absent:  # filters of other tools leave attachments out
        log.assets.damaged.setdefault(name, "it isn't there")
    return translator.worlds.centres


@contextlib.contextmanager
def _damage(log: RecordReader, where: str) -> Iterator[None]:
    try:
        yield
    except _NONSENSE as error:
        raise _nonsense(log, where, error) from error


def _nonsense(log: RecordReader, where: str, error: Exception) -> Damaged:
    return Damaged(log.path, where, f"it makes no sense: {error}")
