"""Files of models that several recordings share: one file beside them, which has attachments only.

A recording refers to it by its base name and the hash of its content, in the metadata :data:`METADATA`. Models that
aren't in it are attached to the run's own recording. The same models make the same file, which has its hash in its
name: so it never changes, and a folder may have several.
"""

from __future__ import annotations

import hashlib
import io
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from pathlib import Path
    from typing import BinaryIO

METADATA: Final = "pycram.models"
"""Name of the metadata in which a recording has the ``file`` and its ``sha256``."""
NAME: Final = re.compile(r"models-[0-9a-f]{12}\.mcap")
_SOURCE: Final = ".py"  # of the plan: each recording keeps that
LIBRARY: Final = "pycram models"  # whatever release: the same models make the same file


@dataclass(frozen=True, slots=True)
class SharedModels:
    """A file of models."""

    file: str
    sha256: str  # of its content, in hex
    keys: frozenset[str]  # names of the files in it, ``<sha256>/<name>``

    @classmethod
    def of(cls, path: Path) -> SharedModels:
        """One that is there."""
        from mcap.reader import SeekingReader  # noqa: PLC0415  readers of recordings have their own

        content = path.read_bytes()
        keys = frozenset(each.name for each in SeekingReader(io.BytesIO(content)).iter_attachments())
        return cls(path.name, hashlib.sha256(content).hexdigest(), keys)


def share_models(recording: Path) -> SharedModels | None:
    """Write the models of a complete recording into a file beside it; return None if it has no models."""
    with recording.open("rb") as file:
        models = sorted(_models(file), key=lambda each: each[0])
    if not models:
        return None
    from recorder.mcap.writer import McapWriter  # noqa: PLC0415  readers don't need it

    content = io.BytesIO()
    writer = McapWriter(content, LIBRARY)
    for name, media_type, data in models:
        writer.add_attachment(0, name, media_type, data)
    writer.finish()
    text = content.getvalue()
    digest = hashlib.sha256(text).hexdigest()
    path = recording.with_name(f"models-{digest[:12]}.mcap")
    part = path.with_name(f".{path.name}.part")
    part.write_bytes(text)
    part.replace(path)
    return SharedModels(path.name, digest, frozenset(name for name, _, _ in models))


def _models(file: BinaryIO) -> list[tuple[str, str, bytes]]:
    from mcap.reader import SeekingReader  # noqa: PLC0415  readers of recordings have their own

    found = SeekingReader(file).iter_attachments()
    return [(each.name, each.media_type, each.data) for each in found if not each.name.endswith(_SOURCE)]
