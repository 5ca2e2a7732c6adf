"""The files of a recording: models, meshes, the plan's source. They are attached to the recording, or in a shared file.

The recordings of a sweep share a file of models (:mod:`recorder.mcap_writer`). Recordings may come from strangers. A
shared file must therefore be a regular file in the recording's folder, and have the recorded hash.
"""

from __future__ import annotations

import hashlib
import io
import os
import stat
import zlib
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, suppress
from io import BufferedReader
from pathlib import Path
from typing import TYPE_CHECKING, Final

from mcap.data_stream import ReadDataStream
from mcap.records import Attachment

from recorder import system
from recorder.mcap_writer import MODELS_METADATA, MODELS_NAME
from replay.errors import Damaged, MissingModels, NoSuchName
from replay.file.index import Index
from replay.file.mcap_format import DAMAGE, Extent, describe

if TYPE_CHECKING:
    from recorder.urdf import Urdf


class Assets(Mapping[str, bytes]):
    """Contents of files by name, ``<sha256>/<file name>``. The files are read on demand."""

    def __init__(self, path: Path, index: Index) -> None:
        self._path = path
        self._index = index
        self._models: dict[str, Urdf] = {}
        self.damaged: dict[str, str] = {}  # causes of known damage, by name of the file
        stated = index.metadata.get(MODELS_METADATA)
        # the file of models that the recording names; None if the recording itself has all models
        self.shared = None if stated is None else SharedFile(path, stated)
        self._looked = False  # whether a call has needed the shared file

    def __getitem__(self, name: str) -> bytes:
        """Return the content of a file.

        Raises:
            KeyError: There is no file with this name.
            Damaged: The content is damaged.
            MissingModels: The shared file can't be read.
        """
        return self.attachment(name).data

    def attachment(self, name: str) -> Attachment:
        """Return a file with its time and media type. :meth:`__getitem__` describes the errors."""
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
        """Read all attached files, and note the damaged files in :attr:`damaged`."""
        for name in self._index.attachments:
            with suppress(Damaged):
                self.attachment(name)

    def missing(self, *, look: bool = False) -> str:
        """Return why shared files are missing; "" if they aren't missing, or if no call has needed them yet."""
        self._looked = self._looked or look
        return self.shared.cause if self.shared is not None and self._looked else ""

    def close(self) -> None:
        """Close the shared file. The next use opens the file again, so forked children have their own file."""
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
        """Return an attached model, whose name is ``<sha256>/<file name>``. Each model is parsed once.

        Raises:
            NoSuchName: The recording doesn't contain the model.
            Damaged: The model's content is damaged.
        """
        if name not in self._models:
            from recorder.urdf import Urdf  # noqa: PLC0415  loads numpy

            try:
                self._models[name] = Urdf.parse(self[name])
            except KeyError:
                raise NoSuchName("attached model", name, self) from None
        return self._models[name]


_SHOWN: Final = 80  # maximum length of an invalid name in messages
#: With O_NONBLOCK, opening a pipe doesn't wait.
_FLAGS: Final = os.O_RDONLY | system.OPENED | system.NO_LINK | getattr(os, "O_NONBLOCK", 0)


class SharedFile:
    """A file of models that the metadata ``stated`` of a recording names. The file is opened on demand."""

    def __init__(self, recording: Path, stated: Mapping[str, str]) -> None:
        self._folder = Path(os.path.realpath(recording)).parent
        self._sha256 = stated.get("sha256", "")
        self._stated = stated.get("file", "")
        self.name = self._stated[:_SHOWN].encode("unicode_escape").decode()  # name of the file in messages
        self._index: Index | None = None
        self._cause: str | None = None  # why the file can't be read; None before the first attempt

    @property
    def cause(self) -> str:
        """Why the file can't be read; "" if it is readable."""
        if self._cause is None:
            try:
                self._index = Index(self._opened())
                self._cause = ""
            except OSError as error:
                self._cause = f"{self.name}: {error.strerror or error}"
            except ValueError as error:
                self._cause = f"{self.name} {error}"
        return self._cause

    @property
    def files(self) -> Mapping[str, Extent]:
        """The attachments by name; empty if the file can't be read."""
        return {} if self.cause or self._index is None else self._index.attachments

    def read(self, name: str) -> bytes:
        """Return the MCAP record of an attachment."""
        if self._index is None:
            raise KeyError(name)
        return self._index.read(self._index.attachments[name])

    def close(self) -> None:
        """Close the file. The next use opens the file again."""
        if self._index is not None:
            self._index.close()
        self._index = self._cause = None

    def _opened(self) -> BufferedReader:
        if not MODELS_NAME.fullmatch(self._stated) or self._stated != f"models-{self._sha256[:12]}.mcap":
            raise ValueError("isn't the name of a file of models")
        path = self._folder / self._stated
        if path.is_symlink():
            raise ValueError("is a symbolic link; links aren't followed")
        with ExitStack() as undoing:
            file = undoing.enter_context(open(path, "rb", opener=lambda name, _: os.open(name, _FLAGS)))
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise ValueError("isn't a regular file")
            if hashlib.file_digest(file, "sha256").hexdigest() != self._sha256:
                raise ValueError("has changed since the recording was made")
            file.seek(0)
            undoing.pop_all()
        return file
