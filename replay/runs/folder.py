"""A folder of recordings as tables, for read-only SQL statements.

The tables are in the subfolder ``tables``: ``contents.json`` lists the recordings, and each *part* is a subfolder with
Parquet files about some recordings. An update reads only new and changed recordings, adds one part, and merges small
parts. A single rename replaces the contents, so a killed update leaves either the old or the new contents. Readers hold
a shared lock on their parts, so obsolete parts stay until the last reader closes.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from glob import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self

import duckdb
import pyarrow as pa
from pyarrow import compute, parquet

from recorder import html, system
from recorder.tracing.interrupts import partial_folder
from replay.errors import NotALog, ReplayError
from replay.file.record_reader import RecordReader
from replay.runs.rows import FOLDER, NEW, partial_rows, read_rows, tables_of, written_rows
from replay.runs.schema import RUN, TABLES, VERSION, arrow_schema

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl

_RUN_FIELD: Final = pa.field(RUN.name, pa.string())
_MODELS: Final = "models-"  # prefix of the names of a sweep's shared models
_CONTENTS: Final = "contents.json"
_PART: Final = re.compile(r"\.?(\d{6,})(\..*)?", re.ASCII)  # name of a part; names of incomplete parts begin with a dot
_BATCH: Final = 200  # maximum number of recordings whose rows are in memory
_PARTS: Final = 8  # number of small parts that are merged
_SMALL: Final = 2000  # number of recordings below which a part is small


class NotRead(ReplayError):
    """The tables of a folder of recordings can't be made or read; the error is made from the path and the cause."""


@dataclass(frozen=True, slots=True)
class Skipped:
    """A file in the folder that has no rows in the tables."""

    name: str
    reason: str


class Folder:
    """A folder of recordings, with its tables. If there is no folder, or no recording in it, NotALog is raised."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.tables = self.path / FOLDER  # the folder of the tables
        if not self.path.is_dir():
            raise NotALog(self.path, "isn't a folder" if self.path.exists() else "there is no such folder")
        if not self.recordings():
            raise NotALog(self.path, "is a folder without recordings")
        self._contents = Contents()
        self._held = contextlib.ExitStack()

    def close(self) -> None:
        """Release the tables. Then other processes may remove obsolete parts."""
        self._held.close()

    @property
    def skipped(self) -> tuple[Skipped, ...]:
        """The files that have no rows in the tables, with reasons."""
        files = sorted(self._contents.files.items())
        return tuple(Skipped(name, facts["reason"]) for name, facts in files if "reason" in facts)

    @property
    def runs(self) -> tuple[str, ...]:
        """Names of the recordings in the tables."""
        return tuple(sorted(name for name, facts in self._contents.files.items() if "part" in facts))

    def files(self, table: str) -> list[str]:
        """Return the Parquet files of a table."""
        tables = self.tables.absolute()  # absolute, because the working directory may change
        return [str(tables / part / f"{table}.parquet") for part in sorted(self._contents.parts)]

    def recordings(self) -> dict[str, os.stat_result]:
        """Return the recordings in the folder by name. The name of an incomplete file begins with a dot."""
        found = {}
        with os.scandir(self.path) as entries:
            for entry in entries:
                if not entry.name.endswith(".mcap") or entry.name.startswith((".", _MODELS)):
                    continue
                if entry.is_symlink():  # a broken link is reported as an unreadable file
                    if not Path(entry.path).is_dir():
                        found[entry.name] = entry.stat(follow_symlinks=Path(entry.path).is_file())
                elif entry.is_file():
                    found[entry.name] = entry.stat()
        return dict(sorted(found.items()))

    def update(self, progress: Callable[[int, int], object] = lambda _done, _all: None) -> None:
        """Update the tables; raise NotRead if they are out of date, and can't be written.

        ``progress`` is called with two numbers: recordings that were read, and all new recordings.
        """
        if self.tables.is_symlink():  # the link's target may be anywhere
            raise NotRead(self.path, f"{self.tables} is a link; remove it and try again")
        self.close()
        try:
            with self._locked():
                self._contents = Contents.read(self.tables)
                self._update(progress)
                self._hold()
        except OSError as error:
            self._contents = Contents.read(self.tables)  # on a read-only disk, the tables may be up to date
            if any(self._changed(self.recordings())):
                reason = error.strerror or str(error)
                cause = f"its tables can't be written ({reason}); copy the folder to a writable place"
                raise NotRead(self.path, cause) from error
            self._hold()

    def _changed(self, present: Mapping[str, os.stat_result]) -> tuple[list[str], list[str]]:
        """Return the recordings in the tables that have changed or are gone, and the recordings that must be read."""
        known = self._contents.files
        stale = [
            name
            for name, facts in known.items()
            if _state(present.get(name)) != {key: facts.get(key) for key in ("size", "mtime_ns")}
        ]
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
        small = {part: names for part, names in self._contents.parts.items() if len(names) < _SMALL}
        if len(small) >= _PARTS:
            self._rewrite(list(small), [name for names in small.values() for name in names])
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
        rows: dict[str, list[pa.Table]] = defaultdict(list)
        names = []
        for name, state in recordings.items():
            done += 1
            try:
                tables = self._rows(name, state)
            except (ReplayError, OSError) as error:
                reason = str(error).removeprefix(f"{self.path / name}: ")
                self._contents.files[name] = _state(state) | {"reason": reason}
                continue
            progress(done, of)
            names.append(name)
            for table, of_table in tables.items():
                run = pa.repeat(pa.scalar(name, pa.string()), len(of_table))
                rows[table].append(of_table.add_column(0, _RUN_FIELD, run))
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
        gone: dict[str, set[str]] = defaultdict(set)
        for name in names:
            facts = self._contents.files.pop(name)
            if "part" in facts:
                gone[facts["part"]].add(name)
        for part in gone:
            rest = [name for name, facts in self._contents.files.items() if facts.get("part") == part]
            if rest:
                self._rewrite([part], rest)

    def _rewrite(self, parts: Sequence[str], names: Sequence[str]) -> None:
        """Write the rows of recordings in parts as a new part."""
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
        part = f"{self._contents.next:06}"
        self._contents.next += 1
        with partial_folder(self.tables / part) as partial:
            for name, table in tables.items():
                parquet.write_table(table, partial / f"{name}.parquet", compression="zstd")
            shutil.rmtree(self.tables / part, ignore_errors=True)  # a killed update may have left this part
            mask = os.umask(0)
            os.umask(mask)
            partial.chmod(0o777 & ~mask)
            partial.rename(self.tables / part)
        return part

    # --- locks -------------------------------------------------------------------------------------------------------

    @contextlib.contextmanager
    def _locked(self) -> Iterator[None]:
        """Lock the tables, so that other processes don't change them."""
        self.tables.mkdir(exist_ok=True)
        (self.tables / NEW).mkdir(exist_ok=True)
        with (self.tables / ".lock").open("w") as lock:
            with contextlib.suppress(OSError):  # some systems don't support locks
                system.lock(lock.fileno(), wait=True)
            yield

    def _hold(self) -> None:
        """Lock these tables until :meth:`close`, so that other processes keep them."""
        for part in self._contents.parts:
            with contextlib.suppress(BlockingIOError):  # another process is just removing the part
                self._held.enter_context(flocked(self.tables / part, exclusive=False))


def _state(state: os.stat_result | None) -> dict[str, Any]:
    return {} if state is None else {"size": state.st_size, "mtime_ns": state.st_mtime_ns}


@dataclass
class Contents:
    """The contents of the tables."""

    #: Facts about each recording by name: its size, its time, and its part or the reason why it can't be read.
    files: dict[str, dict[str, Any]] = field(default_factory=dict)
    next: int = 1  # number that the next part will get

    @property
    def parts(self) -> dict[str, list[str]]:
        """Names of the recordings, by part."""
        found = defaultdict(list)
        for name, facts in self.files.items():
            if "part" in facts:
                found[facts["part"]].append(name)
        return found

    @classmethod
    def read(cls, tables: Path) -> Contents:
        """Return the contents of a folder of tables. Unreadable contents and contents of other releases are empty."""
        numbers = [int(found[1]) for name in parts_there(tables) if (found := _PART.fullmatch(name))]
        nothing = cls(next=max(numbers, default=0) + 1)  # part numbers aren't reused, because readers may use old parts
        try:
            content = json.loads((tables / _CONTENTS).read_text(encoding="utf-8"))
            contents = cls(dict(content["files"]), int(content["next"]))
            decimal = all(part.isdecimal() for part in contents.parts)  # no name may lead out of the folder
            ours = content["version"] == VERSION and decimal
            files = (tables / part / f"{table.name}.parquet" for part in contents.parts for table in TABLES)
            intact = ours and all(map(Path.is_file, files))
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            return nothing
        return contents if intact else nothing

    def write(self, tables: Path) -> None:
        """Write the contents atomically."""
        partial = tables / f".{_CONTENTS}.{os.getpid()}"
        content = {"version": VERSION, "next": self.next, "files": self.files}
        try:
            partial.write_text(json.dumps(content, indent=0), encoding="utf-8")
            partial.replace(tables / _CONTENTS)
        finally:
            partial.unlink(missing_ok=True)


def parts_there(tables: Path) -> set[str]:
    """Return the names of all parts, including obsolete ones."""
    found = tables.iterdir() if tables.is_dir() else ()
    return {each.name for each in found if _PART.fullmatch(each.name) and each.is_dir() and not each.is_symlink()}


@contextlib.contextmanager
def flocked(folder: Path, *, exclusive: bool) -> Iterator[None]:
    """Lock a folder in the ``with`` block; raise BlockingIOError if another process holds the lock.

    On systems without locks, nothing is locked.
    """
    if not system.HAS_LOCKS:  # systems without locks can't open folders
        yield
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        try:
            system.lock(descriptor, shared=not exclusive)
        except BlockingIOError:
            raise
        except OSError:  # some network file systems don't support locks
            pass
        yield
    finally:
        os.close(descriptor)


# --- statements -------------------------------------------------------------------------------------------------------


class Refused(ReplayError):
    """A statement isn't a single SELECT, or can't be executed."""

    def __init__(self, sql: str, cause: str) -> None:
        super().__init__(cause)
        self.sql = sql


class Answer:
    """The rows that a statement selects."""

    def __init__(self, table: pa.Table) -> None:
        names: list[str] = []
        for name in table.column_names:  # names of columns must be unique in JSON objects and data frames
            others = (f"{name}_{number}" for number in range(1, len(table.column_names)))
            names.append(name if name not in names else next(each for each in others if each not in names))
        self._table = table.rename_columns(names)

    def __len__(self) -> int:
        rows: int = self._table.num_rows
        return rows

    def __repr__(self) -> str:
        return f"<Answer: {len(self)} rows of {', '.join(self.columns)}>"

    def _repr_html_(self) -> str:
        shown = Answer(self._table.slice(0, html.MAX_ROWS)).rows()
        more = f"; the first {len(shown)}:" if len(shown) < len(self) else ""
        return html.page(f"{len(self)} row{'' if len(self) == 1 else 's'}{more}", html.table(self.columns, shown))

    @property
    def columns(self) -> list[str]:
        """Names of the columns."""
        return list(self._table.column_names)

    def rows(self) -> list[tuple[Any, ...]]:
        """Return the rows as Python values."""
        return list(zip(*[column.to_pylist() for column in self._table.columns], strict=True))

    def to_arrow(self) -> pa.Table:
        """Return the rows as an Arrow table."""
        return self._table

    def to_pandas(self) -> pd.DataFrame:
        """Return the rows as a data frame of pandas, which must be installed."""
        return self._table.to_pandas()

    def to_polars(self) -> pl.DataFrame:
        """Return the rows as a data frame of polars, which must be installed."""
        import polars as pl  # noqa: PLC0415  optional

        return pl.DataFrame(self._table)


class Runs:
    """A folder of recordings as tables; :func:`replay.open_runs` opens it; a context manager.

    ``progress`` is called with two numbers: recordings that were read, and all new recordings.

    Raises:
        NotALog: There is no such folder.
        NotRead: The tables can't be written next to the recordings.
    """

    def __init__(self, path: str | Path, progress: Callable[[int, int], object] = lambda _done, _all: None) -> None:
        self.folder = Folder(path)
        self.folder.update(progress)
        self._database = duckdb.connect(":memory:")
        database = self._database
        files = {table.name: self.folder.files(table.name) for table in TABLES}
        self._files = [file for each in files.values() for file in each]
        try:
            for table in TABLES:
                name = table.name
                if files[name]:
                    listed = ", ".join(_quoted(escape(file)) for file in files[name])
                    database.execute(f"CREATE VIEW {name} AS SELECT * FROM read_parquet([{listed}])")  # noqa: S608
                else:
                    database.register(f"{name}_rows", pa.schema([_RUN_FIELD, *arrow_schema(table)]).empty_table())
                    database.execute(f"CREATE TABLE {name} AS SELECT * FROM {name}_rows")  # noqa: S608
            allowed = ", ".join(_quoted(name) for file in self._files for name in {file, escape(file)})
            database.execute(f"SET allowed_paths=[{allowed}]")
            database.execute("SET enable_external_access=false")
            database.execute("SET python_enable_replacements=false")
            database.execute("SET TimeZone='UTC'")
            database.execute("SET lock_configuration=true")
        except duckdb.Error as error:
            again = f"its tables can't be read; remove {self.folder.tables} to make them again"
            raise NotRead(self.path, f"{again}: {_first_line(error)}") from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<Runs {self.path}: {len(self)} runs>"

    def _repr_html_(self) -> str:
        counts = self.sql("SELECT outcome, count(*) AS runs FROM runs GROUP BY outcome ORDER BY runs DESC")
        skipped = [f"{each.name} was skipped: {each.reason}" for each in self.skipped]
        title = f"{self.path}: {len(self)} run{'' if len(self) == 1 else 's'}"
        return html.page(title, html.table(counts.columns, counts.rows()), html.text(skipped))

    def __len__(self) -> int:
        return len(self.folder.runs)

    @property
    def path(self) -> Path:
        """The folder."""
        return self.folder.path

    @property
    def skipped(self) -> tuple[Skipped, ...]:
        """The files that have no rows in the tables, with reasons."""
        return self.folder.skipped

    def close(self) -> None:
        """Close the tables."""
        self._database.close()
        self.folder.close()

    def sql(self, statement: str, values: Sequence[object] = ()) -> Answer:
        """Return the rows of a SELECT in DuckDB's SQL, with ? for values. The columns are in `replay.runs.schema`.

        Raises:
            Refused: The statement isn't a single SELECT, opens other files, or is invalid.
            NotRead: The tables were removed.
        """
        try:
            found = self._database.extract_statements(statement)
        except duckdb.Error as error:
            raise Refused(statement, str(error)) from error
        if len(found) != 1 or found[0].type != duckdb.StatementType.SELECT:
            raise Refused(statement, "give a single SELECT statement; the tables of runs are read-only")
        with ThreadPoolExecutor(1) as executor:  # the database doesn't react to Ctrl-C
            selected = executor.submit(lambda: self._database.sql(statement, params=list(values)).to_arrow_table())
            try:
                return Answer(selected.result())
            except KeyboardInterrupt:
                self._database.interrupt()
                raise
            except duckdb.Error as error:
                if not all(Path(file).exists() for file in self._files):
                    raise NotRead(self.path, "its tables were removed; open the folder again") from error
                foreign = isinstance(error, duckdb.PermissionException)
                cause = f"only the folder's own tables are read: {_first_line(error)}" if foreign else str(error)
                raise Refused(statement, cause) from error


def _quoted(text: str) -> str:
    return "'" + text.replace("'", "''") + "'"


def _first_line(error: Exception) -> str:
    return str(error).partition("\n")[0]
