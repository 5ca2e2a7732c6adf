"""The files that are attached to a recording: models, meshes, the plan's source."""

from __future__ import annotations

import hashlib
import io
import zlib
from collections.abc import Mapping
from typing import TYPE_CHECKING

from mcap.data_stream import ReadDataStream
from mcap.records import Attachment

from replay.errors import Damaged, NoSuchName
from replay.file.mcap_format import DAMAGE, describe

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from recorder.geometry.urdf import Urdf
    from replay.file.index import Index


class Assets(Mapping[str, bytes]):
    """Contents by name, ``<sha256>/<file name>``; each is read when it is asked for.

    Attributes:
        damaged: what is wrong with the damaged ones that were read, by name.
    """

    def __init__(self, path: Path, index: Index) -> None:
        self._path = path
        self._index = index
        self._models: dict[str, Urdf] = {}
        self.damaged: dict[str, str] = {}

    def __getitem__(self, name: str) -> bytes:
        """Return the content of a file.

        Raises:
            KeyError: there is none of that name.
            Damaged: it isn't what was attached.
        """
        extent = self._index.attachments[name]
        try:
            content = self._index.read(extent)
            data: bytes = Attachment.read(ReadDataStream(io.BytesIO(content))).data
        except DAMAGE as error:
            raise self._damaged(name, describe(error)) from error
        sha256, slash, _ = name.partition("/")
        corrupt = zlib.crc32(content[:-4]) != int.from_bytes(content[-4:], "little")
        if corrupt or (slash and len(sha256) == 64 and hashlib.sha256(data).hexdigest() != sha256):
            raise self._damaged(name, "its checksum differs")
        return data

    def _damaged(self, name: str, cause: str) -> Damaged:
        self.damaged[name] = cause
        return Damaged(self._path, f"the attached file {name}", cause)

    def __iter__(self) -> Iterator[str]:
        return iter(self._index.attachments)

    def __len__(self) -> int:
        return len(self._index.attachments)

    def urdf(self, name: str) -> Urdf:
        """Return an attached model, ``<sha256>/<file name>``, parsed; once for all who ask.

        Raises:
            NoSuchName: the recording doesn't have it.
            Damaged: it isn't what was attached.
        """
        if name not in self._models:
            from recorder.geometry.urdf import Urdf  # noqa: PLC0415  needs numpy, which most questions don't

            try:
                self._models[name] = Urdf.parse(self[name])
            except KeyError:
                raise NoSuchName("attached model", name, self) from None
        return self._models[name]
