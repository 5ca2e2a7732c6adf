"""Turns records into what the viewer shows, live and afterwards."""

from __future__ import annotations

from enum import Flag, auto
from typing import TYPE_CHECKING, Final

from recorder.viewer.columns import Columns, Moment, simulated
from recorder.viewer.log_view import LogView
from recorder.viewer.scene_view import SceneView

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    import rerun as rr

    from recorder.geometry import Vector
    from recorder.records import Record
    from recorder.records.asset import AssetFile

_BATCH: Final = 20_000  # records; sending fewer takes more time, and more take more room


class Half(Flag):
    """What is shown: two halves that know nothing of each other, of entities of their own."""

    SEEN = auto()
    TOLD = auto()


class Translator:
    """Shows records in a viewer. For one thread.

    Args:
        stream: where it goes.
        root: the entity that all others are below, and the prefix of all frames; "" for none.
        half: what is shown of them; by default all.
    """

    def __init__(self, stream: rr.RecordingStream, root: str = "", half: Half = Half.SEEN | Half.TOLD) -> None:
        self._columns = Columns(stream, root)
        self._stage = SceneView(self._columns, f"{root}/" if root else "")
        report = LogView(self._columns)
        self._shows = [part.show for wanted, part in ((Half.TOLD, report), (Half.SEEN, self._stage)) if wanted in half]
        self._sim = 0  # ns, of the world that something happened in last
        self._waiting = 0  # records

    @property
    def worlds(self) -> Mapping[str, Vector]:
        """Middles of the worlds that plans did something in, when they began to."""
        return self._stage.worlds

    @property
    def front(self) -> str:
        """The world where a plan goes on: of those that are still open the first; "" before there is one."""
        return self._stage.front

    @property
    def absent(self) -> Iterable[str]:
        """Files that bodies are made of and that were not attached, as ``<sha256>/<file name>``; one a body."""
        return self._stage.absent

    def attach(self, asset: AssetFile) -> None:
        """Takes a file.

        Args:
            asset: a model or mesh, before the records that use it, or anything else.
        """
        self._stage.attach(asset)

    def show(self, record: Record) -> None:
        """Takes a record; what it changes is sent in batches, at the latest by :meth:`flush`.

        Args:
            record: the next one.
        """
        if record.world:
            self._sim = simulated(record.sim_step)
        now = Moment(record.seq, self._sim, record.wall_time_ns)
        for show in self._shows:
            show(record, now)
        self._waiting += 1
        if self._waiting >= _BATCH:
            self.flush()

    def flush(self) -> None:
        """Sends what was gathered; costs nothing if that is nothing."""
        self._columns.flush()
        self._waiting = 0

    def finish(self) -> None:
        """Ends: names worlds too that nothing was done in, and sends what was gathered."""
        self._stage.finish()
        self.flush()
