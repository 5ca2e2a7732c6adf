"""Translates records into rows for the viewer, live and afterwards."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from recorder.viewer.columns import Columns, TimePoint, sim_ns
from recorder.viewer.log_view import LogView
from recorder.viewer.scene_view import SceneView

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    import rerun as rr

    from recorder.geometry import Vector
    from recorder.records import Record
    from recorder.records.asset import AssetFile

_BATCH: Final = 20_000  # records; sending fewer takes more time, and more take more memory


class Translator:
    """Shows records in a viewer, below a root entity and with frames of that prefix if one is named. For one thread."""

    def __init__(self, stream: rr.RecordingStream, root: str = "") -> None:
        self._columns = Columns(stream, root)
        self._log_view = LogView(self._columns)
        self._scene_view = SceneView(self._columns, f"{root}/" if root else "")
        self._sim_ns = 0  # of the world of the latest record that has one
        self._waiting = 0  # records

    @property
    def worlds(self) -> Mapping[str, Vector]:
        """Centres in m of the worlds that plans acted in, when they began to."""
        return self._scene_view.worlds

    @property
    def front(self) -> str:
        """The first of these worlds that is still open; "" before there is one."""
        return self._scene_view.front

    @property
    def absent(self) -> Iterable[str]:
        """Files that bodies are made of and that were not attached, as ``<sha256>/<file name>``; one a body."""
        return self._scene_view.scene.absent

    def attach(self, asset: AssetFile) -> None:
        """Takes a model or mesh, before the records that use it, or anything else."""
        self._scene_view.attach(asset)

    def show(self, record: Record) -> None:
        """Takes the next record; its rows are sent in batches, at the latest by :meth:`flush`."""
        if record.world:
            self._sim_ns = sim_ns(record.sim_step)
        now = TimePoint(record.seq, self._sim_ns, record.wall_time_ns)
        self._log_view.show(record, now)
        self._scene_view.show(record, now)
        self._waiting += 1
        if self._waiting >= _BATCH:
            self.flush()

    def flush(self) -> None:
        """Sends all buffered rows."""
        self._columns.flush()
        self._waiting = 0

    def finish(self) -> None:
        """Ends: adds the worlds that no plan acted in, and sends all buffered rows."""
        self._scene_view.finish()
        self.flush()
