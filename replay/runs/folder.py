"""The tables of a folder of recordings: made from new and changed recordings only, and replaced in one go.

Beside the recordings lies ``tables/``: ``contents.json``, which says what is in the tables, and in folders of their own
the Parquet files of the tables, called parts: each has the rows of some recordings. What is added is a part of its own;
small parts are merged. The new contents replace the old ones by one rename, so a kill leaves the old tables or the new
ones. Readers hold a lock on the parts that they have, shared: what is obsolete stays until nobody reads it any more.
Recordings that can't be read, or are of a newer release, are named and left out.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import pyarrow as pa
from pyarrow import compute, parquet

from replay.errors import NotALog, ReplayError
from replay.file.record_reader import RecordReader
from replay.runs.contents import Contents, flocked, parts_there
from replay.runs.record_rows import tables_of
from replay.runs.rows import FOLDER, NEW, partial_rows, read_rows, written_rows
from replay.runs.schema import RUN, TABLES, arrow_schema

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

_RUN_FIELD: Final = pa.field(RUN.name, pa.string())
_MODELS: Final = "models-"  # files of models that a sweep's recordings share
_BATCH: Final = 200  # recordings whose rows are in memory at once
_PARTS: Final = 8  # small parts that are merged into one
_SMALL: Final = 2000  # recordings in a part that is still merged with others


class NotRead(ReplayError):
    """The tables of a folder of recordings can't be made or read.

    Attributes:
        path: the folder.
        cause: the reason.
    """

    def __init__(self, path: Path, cause: str) -> None:
        super().__init__(f"{path}: {cause}")
        self.path = str(path)
        self.cause = cause


@dataclass(frozen=True, slots=True)
class Skipped:
    """A file of the folder that is left out.

    Attributes:
        name: of the file.
        reason: in words.
    """

    name: str
    reason: str


class Folder:
    """A folder of recordings, with its tables.

    Args:
        path: the folder.

    Raises:
        NotALog: there is no such folder, or no recording in it.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        if not self.path.is_dir():
            raise NotALog(self.path, "is no folder of recordings" if self.path.exists() else "there is no such folder")
        if not self.recordings():
            raise NotALog(self.path, "is a directory in which no recording lies")
        self._contents = Contents()
        self._held = contextlib.ExitStack()

    def close(self) -> None:
        """Let go of the tables, which other processes may then remove when they bring them up to date."""
        self._held.close()

    @property
    def tables(self) -> Path:
        """The folder of the tables."""
        return self.path / FOLDER

    @property
    def skipped(self) -> tuple[Skipped, ...]:
        """The files that are left out, each with the reason."""
        files = sorted(self._contents.files.items())
        return tuple(Skipped(name, facts["reason"]) for name, facts in files if "reason" in facts)

    @property
    def runs(self) -> tuple[str, ...]:
        """Names of the recordings in the tables."""
        return tuple(sorted(name for name, facts in self._contents.files.items() if "part" in facts))

    def files(self, table: str) -> list[str]:
        """Return the Parquet files of a table."""
        tables = self.tables.absolute()  # wherever the process goes meanwhile
        return [str(tables / part / f"{table}.parquet") for part in sorted(self._contents.parts)]

    def recordings(self) -> dict[str, os.stat_result]:
        """Return the recordings that are in the folder now, by name; what begins with a dot is being written."""
        found = {}
        with os.scandir(self.path) as entries:
            for entry in entries:
                ours = entry.name.endswith(".mcap") and not entry.name.startswith((".", _MODELS))
                if not ours:
                    continue
                if entry.is_symlink():  # one to nothing can't be read, and is named for it
                    if not Path(entry.path).is_dir():
                        found[entry.name] = entry.stat(follow_symlinks=Path(entry.path).is_file())
                elif entry.is_file():
                    found[entry.name] = entry.stat()
        return dict(sorted(found.items()))

    def update(self, progress: Callable[[int, int], object] = lambda _done, _all: None) -> None:
        """Bring the tables up to date.

        Args:
            progress: is called with how many of how many recordings are read.

        Raises:
            NotRead: the tables aren't up to date, and can't be written.
        """
        if self.tables.is_symlink():  # what lies elsewhere isn't ours to replace
            raise NotRead(self.path, f"{self.tables} is a link; remove it, and tables are made in its place")
        self.close()
        try:
            with self._locked():
                self._contents = Contents.read(self.tables)
                self._update(progress)
                self._hold()
        except OSError as error:
            self._contents = Contents.read(self.tables)  # such as on a read-only disk: they may be there
            if any(self._changed(self.recordings())):
                reason = error.strerror or str(error)
                cause = f"its tables can't be written ({reason}); copy it to where they can be"
                raise NotRead(self.path, cause) from error
            self._hold()

    def _changed(self, present: Mapping[str, os.stat_result]) -> tuple[list[str], list[str]]:
        """Return which recordings in the tables have changed or are gone, and which ones are to be read."""
        known = self._contents.files
        stale = [name for name, facts in known.items() if _state(present.get(name)) != _known_state(facts)]
        return stale, [name for name in present if name not in known or name in stale]

    def _update(self, progress: Callable[[int, int], object]) -> None:
        present = self.recordings()
        stale, wanted = self._changed(present)
        if not stale and not wanted:
            return
        self._drop(stale)
        for start in range(0, len(wanted), _BATCH):
            batch = wanted[start : start + _BATCH]
            progress(start, len(wanted))
            self._add({name: present[name] for name in batch}, progress, start, len(wanted))
        self._merge()
        self._contents.write(self.tables)
        for part in parts_there(self.tables) - set(self._contents.parts):
            with contextlib.suppress(BlockingIOError), flocked(self.tables / part, exclusive=True):
                shutil.rmtree(self.tables / part, ignore_errors=True)
        for name in wanted:
            for rows in (written_rows(self.path / name), partial_rows(self.path / name)):
                rows.unlink(missing_ok=True)

    def _add(
        self, recordings: Mapping[str, os.stat_result], progress: Callable[[int, int], object], done: int, of: int
    ) -> None:
        """Read recordings, and write their rows as a part."""
        rows: dict[str, list[pa.Table]] = defaultdict(list)
        names = []
        for name, state in recordings.items():
            done += 1
            try:
                tables = self._rows(name, state)
            except (ReplayError, OSError) as error:
                self._contents.files[name] = _state(state) | {"reason": _reason(self.path / name, error)}
                continue
            progress(done, of)
            names.append(name)
            for table, of_table in tables.items():
                rows[table].append(_with_run(of_table, name))
        if not names:
            return
        part = self._write_part({table: pa.concat_tables(parts) for table, parts in rows.items()})
        for name in names:
            self._contents.files[name] = _state(recordings[name]) | {"part": part}

    def _rows(self, name: str, state: os.stat_result) -> dict[str, pa.Table]:
        path = self.path / name
        written = read_rows(path, state)
        if written is not None:
            return written
        with RecordReader(path) as log:
            if log.newer is not None:
                raise NotRead(path, str(log.newer))
            if log.live:
                raise NotRead(path, "it is still being written")
            tables = tables_of(log)
            log.assets.check()
            if log.damage:
                raise NotRead(path, log.damage)
            return tables

    # --- parts -------------------------------------------------------------------------------------------------------

    def _drop(self, names: Iterable[str]) -> None:
        """Leave recordings out that changed or are gone."""
        gone: dict[str, set[str]] = defaultdict(set)
        for name in names:
            facts = self._contents.files.pop(name)
            if "part" in facts:
                gone[facts["part"]].add(name)
        for part in gone:
            rest = [name for name, facts in self._contents.files.items() if facts.get("part") == part]
            if rest:
                self._rewrite([part], rest)

    def _merge(self) -> None:
        """Merge small parts where there are many."""
        small = {part: names for part, names in self._contents.parts.items() if len(names) < _SMALL}
        if len(small) >= _PARTS:
            self._rewrite(list(small), [name for names in small.values() for name in names])

    def _rewrite(self, parts: Sequence[str], names: Sequence[str]) -> None:
        """Write the rows of some recordings of some parts as one new part."""
        kept = pa.array(names, pa.string())
        tables = {}
        for table in TABLES:
            files = [self.tables / part / f"{table.name}.parquet" for part in parts]
            rows = pa.concat_tables([parquet.ParquetFile(file).read() for file in files])
            tables[table.name] = rows.filter(compute.is_in(rows[RUN.name], kept))
        part = self._write_part(tables)
        for name in names:
            self._contents.files[name]["part"] = part

    def _write_part(self, tables: Mapping[str, pa.Table]) -> str:
        """Write tables as a part, and return its name."""
        part = f"{self._contents.next:06}"
        self._contents.next += 1
        partial = Path(tempfile.mkdtemp(prefix=f".{part}.", dir=self.tables))
        try:
            for name, table in tables.items():
                parquet.write_table(table, partial / f"{name}.parquet", compression="zstd")
            shutil.rmtree(self.tables / part, ignore_errors=True)  # of an update that was killed
            partial.chmod(0o777 & ~_umask())
            partial.rename(self.tables / part)
        except BaseException:
            shutil.rmtree(partial, ignore_errors=True)
            raise
        return part

    # --- locks -------------------------------------------------------------------------------------------------------

    @contextlib.contextmanager
    def _locked(self) -> Iterator[None]:
        """Let no other process change the tables meanwhile."""
        self.tables.mkdir(exist_ok=True)
        (self.tables / NEW).mkdir(exist_ok=True)
        with (self.tables / ".lock").open("w") as lock:
            if fcntl is not None:
                fcntl.flock(lock, fcntl.LOCK_EX)
            yield

    def _hold(self) -> None:
        """Keep other processes from removing these tables until they are closed."""
        for part in self._contents.parts:
            with contextlib.suppress(BlockingIOError):  # it isn't waited for
                self._held.enter_context(flocked(self.tables / part, exclusive=False))


def _state(state: os.stat_result | None) -> dict[str, Any]:
    return {} if state is None else {"size": state.st_size, "mtime_ns": state.st_mtime_ns}


def _known_state(facts: Mapping[str, Any]) -> dict[str, Any]:
    return {key: facts.get(key) for key in ("size", "mtime_ns")}


def _with_run(table: pa.Table, name: str) -> pa.Table:
    return table.add_column(0, _RUN_FIELD, pa.repeat(pa.scalar(name, pa.string()), len(table)))


def _reason(path: Path, error: Exception) -> str:
    return str(error).removeprefix(f"{path}: ")


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def empty_tables() -> dict[str, pa.Table]:
    """Return the tables of a folder without recordings."""
    return {table.name: pa.schema([_RUN_FIELD, *arrow_schema(table)]).empty_table() for table in TABLES}
