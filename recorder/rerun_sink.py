"""Shows a recording live in a Rerun viewer that runs already; a viewer that stalls or dies costs the plan nothing.

Records are put into a bounded queue; a thread of its own turns them into frames (entity ``tf/BODY/LINK``) and lines
(entity ``log``) on the timelines ``step`` and ``sim``. If the viewer can't follow, the oldest records are dropped and
counted: the file has them all.
"""

from __future__ import annotations

import contextlib
import ctypes
import socket
import sys
import threading
from collections import deque
from typing import TYPE_CHECKING, Final
from urllib.parse import urlparse

import rerun as rr

from recorder.errors import RecordingError
from recorder.frames import FrameTree
from recorder.log_lines import text_of
from recorder.records import TOPICS, Keyframe

if TYPE_CHECKING:
    from recorder.asset import AssetFile
    from recorder.records import Record

_MOST_WAITING: Final = 10_000  # records
_PATIENCE: Final = 2.0  # s for the viewer to take what is left at the end
_STEPS: Final = 240  # a simulated second
_KINDS: Final = {topic: kind for kind, topic in TOPICS.items()}
_PORT: Final = 9876
_SCHEMES: Final = ("rerun", "rerun+http", "rerun+https")
_HINT: Final = "say rerun+http://127.0.0.1:9876/proxy"


class RerunSink:
    """A sink that is a running viewer.

    Args:
        url: its address, "rerun+http://127.0.0.1:9876/proxy".
        title: name of the recording.

    Raises:
        RecordingError: nothing answers there.
    """

    def __init__(self, url: str, title: str) -> None:
        self._url = url
        _probe(url)
        self._stream = rr.RecordingStream(title)
        rr.unregister_shutdown()  # at exit it would wait for a viewer that doesn't answer any more
        self._stream.set_sinks(rr.GrpcSink(url))
        self._frames = FrameTree()
        self._waiting: deque[tuple[str, bytes] | AssetFile] = deque()
        self._changed = threading.Condition()
        self._ended = False
        self.dropped = 0
        self._thread = threading.Thread(target=self._run, name="live viewer", daemon=True)
        self._thread.start()

    def write(self, topic: str, record: Record, payload: bytes) -> None:  # noqa: ARG002  the record is not kept
        """Takes a record; see :class:`recorder.journal.Sink`."""
        self._put((topic, payload))

    def attach(self, asset: AssetFile) -> None:
        """Takes a file; see :class:`recorder.journal.Sink`."""
        if asset.name.endswith(".urdf"):
            self._put(asset)

    def _put(self, item: tuple[str, bytes] | AssetFile) -> None:
        with self._changed:
            if len(self._waiting) >= _MOST_WAITING:
                self._waiting.popleft()
                self.dropped += 1
            self._waiting.append(item)
            self._changed.notify()

    def close(self) -> None:
        """Ends; waits a moment for the viewer, but not for ever."""
        with self._changed:
            if self._ended:
                return
            self._ended = True
            self._changed.notify()
        self._thread.join(_PATIENCE)
        self._abandon()
        left = self.dropped + len(self._waiting)
        if left:
            print(f"recorder: the viewer at {self._url} missed {left} records; the file has them", file=sys.stderr)

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._ended)
                if not self._waiting:
                    break
                item = self._waiting.popleft()
            if isinstance(item, tuple):
                topic, payload = item
                self._show(_KINDS[topic].FromString(payload))
            else:
                self._frames.learn(item.sha256, item.content)
        with contextlib.suppress(Exception):  # the viewer's library has its own errors; the viewer is gone or stalled
            self._stream.flush(timeout_sec=_PATIENCE / 2)

    def _abandon(self) -> None:
        """Keeps the stream alive for ever: freed, it waits for its viewer without end, flushed or not."""
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(self._stream))

    def _show(self, record: Record) -> None:
        stream = self._stream
        stream.set_time("step", sequence=record.seq)
        if record.world:
            stream.set_time("sim", duration=record.sim_step / _STEPS)
        for _, message in self._frames.transforms(record):
            for frame in message.transforms:
                at, turn = frame.translation, frame.rotation
                stream.set_time("sim", duration=frame.timestamp.seconds + frame.timestamp.nanos / 1e9)
                transform = rr.Transform3D(
                    translation=[at.x, at.y, at.z],
                    quaternion=rr.Quaternion(xyzw=[turn.x, turn.y, turn.z, turn.w]),
                    parent_frame=frame.parent_frame_id,
                    child_frame=frame.child_frame_id,
                )
                stream.log(f"tf/{frame.child_frame_id}", transform)
        if not isinstance(record, Keyframe):
            stream.log("log", rr.TextLog(text_of(record)[0]))


def _probe(url: str) -> None:
    """Makes sure that somebody listens: the viewer's library would wait for seconds, and then say nothing."""
    try:
        place = urlparse(url)
        port = place.port or _PORT
    except ValueError as error:
        raise RecordingError(url, f"is no address of a viewer ({error})", _HINT) from error
    if place.scheme not in _SCHEMES or place.hostname is None or place.path.rstrip("/") != "/proxy":
        raise RecordingError(url, "is no address of a viewer", _HINT)
    try:
        socket.create_connection((place.hostname, port), timeout=1.0).close()
    except OSError as error:
        raise RecordingError(url, f"no viewer answers ({error})", "start one: rerun") from error
