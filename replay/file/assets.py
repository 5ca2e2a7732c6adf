"""The files of a recording: models, meshes, the plan's source; attached to it, or in a file that several share."""

from __future__ import annotations

import hashlib
import io
import zlib
from collections.abc import Mapping
from contextlib import suppress
from typing import TYPE_CHECKING

from mcap.data_stream import ReadDataStream
from mcap.records import Attachment

from replay.errors import Damaged, MissingModels, NoSuchName
from replay.file.mcap_format import DAMAGE, describe
from replay.file.shared_models import shared_by

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from recorder.geometry.urdf import Urdf
    from replay.file.index import Index


class Assets(Mapping[str, bytes]):
    """Contents by name, ``<sha256>/<file name>``; each is read when it is asked for.

    Attributes:
        damaged: what is wrong with the damaged ones that were read, by name.
        shared: the file of models that the recording names; None if it holds all itself.
    """

    def __init__(self, path: Path, index: Index) -> None:
        self._path = path
        self._index = index
        self._models: dict[str, Urdf] = {}
        self.damaged: dict[str, str] = {}
        self.shared = shared_by(path, index)
        self._looked = False  # into the shared file

    def __getitem__(self, name: str) -> bytes:
        """Return the content of a file.

        Raises:
            KeyError: there is none of that name.
            Damaged: it isn't what was attached.
            MissingModels: it is in none of the files that can be read.
        """
        data: bytes = self.attachment(name).data
        return data

    def attachment(self, name: str) -> Attachment:
        """Return a file with what the recorder said of it; raises as :meth:`__getitem__`."""
        try:
            content = self._content(name)
            found: Attachment = Attachment.read(ReadDataStream(io.BytesIO(content)))
            data = found.data
        except KeyError:
            raise
        except DAMAGE as error:
            raise self._damaged(name, describe(error)) from error
        sha256, slash, _ = name.partition("/")
        corrupt = zlib.crc32(content[:-4]) != int.from_bytes(content[-4:], "little")
        if corrupt or (slash and len(sha256) == 64 and hashlib.sha256(data).hexdigest() != sha256):
            raise self._damaged(name, "its checksum differs")
        return found

    def _content(self, name: str) -> bytes:
        extent = self._index.attachments.get(name)
        if extent is not None:
            return self._index.read(extent)
        if self.shared is None:
            raise KeyError(name)
        if cause := self.missing(look=True):
            raise MissingModels(self._path, cause)
        return self.shared.read(name)

    def check(self) -> None:
        """Read all that the recording holds itself; :attr:`damaged` then tells what isn't as it was attached."""
        for name in self._index.attachments:
            with suppress(Damaged):
                self.attachment(name)

    def missing(self, *, look: bool = False) -> str:
        """Return why files are missing that the recording shares, in words; "" if none are, or nobody has looked."""
        self._looked = self._looked or look
        return self.shared.cause if self.shared is not None and self._looked else ""

    def close(self) -> None:
        """Close the shared file, which is opened again when it is needed: a fork has one of its own."""
        if self.shared is not None:
            self.shared.close()

    def _damaged(self, name: str, cause: str) -> Damaged:
        self.damaged[name] = cause
        return Damaged(self._path, f"the attached file {name}", cause)

    def __iter__(self) -> Iterator[str]:
        own = self._index.attachments
        yield from own
        if self.shared is not None and not self.missing(look=True):
            yield from (name for name in self.shared.files if name not in own)

    def __len__(self) -> int:
        return sum(1 for _ in self)

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
