"""Files that a recording carries so that it stands alone: models, meshes, the plan's source."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256

from recorder.records.values import escaped


@dataclass(frozen=True)
class AssetFile:
    """One file, identified by its content; its name has no folders."""

    name: str
    content: bytes
    media_type: str = "application/octet-stream"

    def __post_init__(self) -> None:
        object.__setattr__(self, "name", escaped(self.name))

    @cached_property
    def sha256(self) -> str:
        """SHA-256 of the content in hex."""
        return sha256(self.content).hexdigest()

    @property
    def key(self) -> str:
        """The attachment's name in the recording: ``<sha256>/<name>``."""
        return f"{self.sha256}/{self.name}"
