"""The file of models that a recording of a sweep shares with others; see :mod:`recorder.mcap.shared_models`.

A recording may come from anybody, so what it names is opened only if it lies in the recording's own folder, is a
regular file and no link, and has the content that the recording was made with.
"""

from __future__ import annotations

import hashlib
import os
import stat
from pathlib import Path
from typing import TYPE_CHECKING, Final

from recorder.mcap.shared_models import METADATA, NAME
from replay.file.index import Index

if TYPE_CHECKING:
    from collections.abc import Mapping
    from io import BufferedReader

    from replay.file.mcap_format import Extent

_SHOWN: Final = 80  # characters of a name that is none
_FLAGS: Final = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)  # a pipe would wait


class SharedFile:
    """The file that a recording names; opened when it is needed first.

    Args:
        recording: the recording.
        stated: how it names the file.

    Attributes:
        name: of the file, as it is shown.
    """

    def __init__(self, recording: Path, stated: Mapping[str, str]) -> None:
        self._folder = Path(os.path.realpath(recording)).parent
        self._sha256 = stated.get("sha256", "")
        self._stated = stated.get("file", "")
        self.name = self._stated[:_SHOWN].encode("unicode_escape").decode()
        self._index: Index | None = None
        self._cause: str | None = None  # why it isn't there; None if it wasn't looked for yet

    @property
    def cause(self) -> str:
        """Why it can't be read; "" if it can."""
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
        """The files in it by their names; none if it can't be read."""
        return {} if self.cause or self._index is None else self._index.attachments

    def read(self, name: str) -> bytes:
        """Return the MCAP record of a file in it."""
        if self._index is None:
            raise KeyError(name)
        return self._index.read(self._index.attachments[name])

    def close(self) -> None:
        """Close it; it would be opened again."""
        if self._index is not None:
            self._index.close()
        self._index = self._cause = None

    def _opened(self) -> BufferedReader:
        if not NAME.fullmatch(self._stated) or self._stated != f"models-{self._sha256[:12]}.mcap":
            raise ValueError("is no name of a file of models")
        path = self._folder / self._stated
        if path.is_symlink():  # where the system has no flag for it
            raise ValueError("is a link, which isn't followed")
        file = open(path, "rb", opener=lambda name, _: os.open(name, _FLAGS))  # noqa: SIM115  the index closes it
        try:
            self._check(file)
        except BaseException:
            file.close()
            raise
        return file

    def _check(self, file: BufferedReader) -> None:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise ValueError("is no regular file")
        if hashlib.file_digest(file, "sha256").hexdigest() != self._sha256:
            raise ValueError("has another content than the one that the recording was made with")
        file.seek(0)


def shared_by(recording: Path, index: Index) -> SharedFile | None:
    """Return the file of models that a recording names; None if it holds all itself."""
    stated = index.metadata.get(METADATA)
    return None if stated is None else SharedFile(recording, stated)
