"""A folder of recordings as tables, for SQL statements that only read.

DuckDB executes them in memory, from the Parquet files of the folder. It is sandboxed: it accepts single SELECT
statements, opens no other files, and its settings are locked.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from glob import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import duckdb

from replay.errors import ReplayError
from replay.runs.folder import Folder, NotRead, empty_tables
from replay.runs.schema import TABLES

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from types import TracebackType
    from typing import Self

    import pandas as pd
    import polars as pl
    import pyarrow as pa

    from replay.runs.folder import Skipped

_SINGLE: Final = "give a single SELECT statement: the tables of runs are read-only"


class Refused(ReplayError):
    """A statement doesn't only read the tables, or can't be executed."""

    def __init__(self, sql: str, cause: str) -> None:
        super().__init__(cause)
        self.sql = sql
        self.cause = cause


class Answer:
    """The rows that a statement selects."""

    def __init__(self, table: pa.Table) -> None:
        names: list[str] = []
        for name in table.column_names:  # unlike joined tables, JSON objects and data frames need unique names
            others = (f"{name}_{number}" for number in range(1, len(table.column_names)))
            names.append(name if name not in names else next(each for each in others if each not in names))
        self._table = table.rename_columns(names)

    def __len__(self) -> int:
        rows: int = self._table.num_rows
        return rows

    def __repr__(self) -> str:
        return f"<Answer: {len(self)} rows of {', '.join(self.columns)}>"

    @property
    def columns(self) -> list[str]:
        """Names of the columns."""
        return list(self._table.column_names)

    def rows(self) -> list[tuple[Any, ...]]:
        """Return the rows as Python values."""
        columns = [column.to_pylist() for column in self._table.columns]
        return list(zip(*columns, strict=True))

    def to_arrow(self) -> pa.Table:
        """Return the rows as an Arrow table."""
        return self._table

    def to_pandas(self) -> pd.DataFrame:
        """Return the rows as a pandas data frame; pandas must be installed."""
        return self._table.to_pandas()

    def to_polars(self) -> pl.DataFrame:
        """Return the rows as a polars data frame; polars must be installed."""
        import polars as pl  # noqa: PLC0415  optional

        return pl.DataFrame(self._table)


class Runs:
    """A folder of recordings as tables; :func:`replay.open_runs` opens it. A context manager.

    ``progress`` is called with the number of new recordings that were read, and of all new recordings.

    Raises:
        NotALog: there is no such folder.
        NotRead: its tables can't be written next to the recordings.
    """

    def __init__(self, path: str | Path, progress: Callable[[int, int], object] = lambda _done, _all: None) -> None:
        self.folder = Folder(path)
        self.folder.update(progress)
        self._database = duckdb.connect(":memory:")
        self._open()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<Runs {self.path}: {len(self)} runs>"

    def __len__(self) -> int:
        return len(self.folder.runs)

    @property
    def path(self) -> Path:
        """The folder."""
        return self.folder.path

    @property
    def skipped(self) -> tuple[Skipped, ...]:
        """The files without rows, each with the reason."""
        return self.folder.skipped

    def close(self) -> None:
        """Close the tables."""
        self._database.close()
        self.folder.close()

    def sql(self, statement: str, values: Sequence[object] = ()) -> Answer:
        """Return what a statement selects from the tables; docs/runs.md has their columns.

        Args:
            statement: a SELECT in DuckDB's SQL, with ? for values.
            values: the values.

        Raises:
            Refused: the statement isn't a single SELECT, opens other files, or is invalid.
            NotRead: the tables were removed since they were opened.
        """
        try:
            found = self._database.extract_statements(statement)
        except duckdb.Error as error:
            raise Refused(statement, str(error)) from error
        if len(found) != 1 or found[0].type != duckdb.StatementType.SELECT:
            raise Refused(statement, _SINGLE)
        with ThreadPoolExecutor(1) as executor:  # the database doesn't react to Ctrl-C
            selected = executor.submit(lambda: self._database.sql(statement, params=list(values)).to_arrow_table())
            try:
                return Answer(selected.result())
            except KeyboardInterrupt:
                self._database.interrupt()
                raise
            except duckdb.Error as error:
                raise self._error(statement, error) from error

    def _error(self, statement: str, error: duckdb.Error) -> ReplayError:
        """Return the error to raise for an error of the database."""
        if not all(Path(file).exists() for file in self._files):
            return NotRead(self.path, "its tables were removed since they were opened; open the folder again")
        if isinstance(error, duckdb.PermissionException):
            return Refused(statement, f"only the folder's own tables are read: {_first_line(error)}")
        return Refused(statement, str(error))

    def _open(self) -> None:
        """Create the views and lock the settings."""
        database = self._database
        files = {table.name: self.folder.files(table.name) for table in TABLES}
        self._files = [file for each in files.values() for file in each]
        try:
            for name, empty in empty_tables().items():
                if files[name]:
                    listed = ", ".join(_quoted(escape(file)) for file in files[name])
                    database.execute(f"CREATE VIEW {name} AS SELECT * FROM read_parquet([{listed}])")  # noqa: S608
                else:
                    database.register(f"{name}_rows", empty)
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


def _quoted(text: str) -> str:
    return "'" + text.replace("'", "''") + "'"


def _first_line(error: Exception) -> str:
    return str(error).partition("\n")[0]
