"""A folder of recordings as tables: what they hold, that they follow the recordings, and that SQL only reads."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from mcap.reader import make_reader

import replay
from recorder.records import Mutation, Query, Task
from replay.cli.main import main
from replay.runs.folder import Folder, NotRead, Refused, Runs
from replay.runs.rows import write_rows
from tests.replay.file.test_newer import forge
from tests.replay.runs.conftest import COUNT

if TYPE_CHECKING:
    from collections.abc import Sequence

GOLDEN = Path(__file__).parents[1] / "golden" / "0.1.0.mcap"
pytestmark = pytest.mark.slow


def read(folder: Path) -> Sequence[int]:
    """How many recordings an update reads."""
    done: list[int] = []
    with Runs(folder, lambda number, _: done.append(number)):
        return sorted(set(done) - {0})


def test_tables_hold_what_the_recordings_do(runs: Path) -> None:
    counts = {Task: 0, Query: 0, Mutation: 0}
    ids = set()
    for recording in runs.glob("*.mcap"):
        with replay.open(recording) as log:
            counts[Query] += log.counts().get("query", 0)
            counts[Mutation] += log.counts()["mutation"]
            ids |= {(recording.name, record.task) for record in log.records(Task)}
    with replay.open_runs(runs) as tables:
        assert len(tables) == COUNT
        assert tables.sql("SELECT count(*) FROM tasks").rows() == [(len(ids),)]
        assert tables.sql("SELECT count(*) FROM queries").rows() == [(counts[Query],)]
        assert tables.sql("SELECT count(*) FROM mutations").rows() == [(counts[Mutation],)]
        failed = tables.sql("SELECT cause, count(*) FROM runs WHERE NOT succeeded GROUP BY cause").rows()
        right = tables.sql(
            "SELECT count(DISTINCT run) FROM tasks WHERE label = 'pick-up(spoon)' AND parameters->>'arm' = 'right'"
        ).rows()[0][0]
        of_spoon = dict(failed)["Dropped at let-go/Moving: spoon fell at #"]
        assert of_spoon == right > 0, "places differ, which makes no other cause"
        assert tables.sql("SELECT DISTINCT parameters['material'] FROM runs ORDER BY 1").rows() == [
            ('"glass"',),
            ('"metal"',),
            ('"wood"',),
        ]


def test_where_bodies_are_is_what_the_recording_has(runs: Path) -> None:
    name = min(runs.glob("*.mcap")).name
    with replay.open_runs(runs) as tables, replay.open(runs / name) as log:
        state = log.state_at(log.final_step()).world("kitchen")
        last = tables.sql("SELECT body, arg_max([x, y, z], step) FROM poses WHERE run = ? GROUP BY body", [name])
        assert {body: tuple(place) for body, place in last.rows()} == {
            body.name: body.position for body in state.bodies.values()
        }


def test_only_new_and_changed_recordings_are_read(runs: Path) -> None:
    names = sorted(path.name for path in runs.glob("*.mcap"))
    shutil.move(runs / names[0], runs.parent)
    assert read(runs)[-1] == COUNT - 1
    assert read(runs) == []
    shutil.move(runs.parent / names[0], runs)
    assert read(runs) == [1]
    shutil.copy2(runs / names[2], runs / names[1])
    (runs / names[3]).unlink()
    assert read(runs) == [1]
    with Runs(runs) as tables:
        found = dict(tables.sql("SELECT run, seed FROM runs").rows())
    assert set(found) == set(names) - {names[3]}
    assert found[names[1]] == found[names[2]] == "2", "the new content counts"


def test_rows_of_the_runs_own_process_are_those_of_its_file(runs: Path) -> None:
    with Runs(runs) as tables:
        before = {
            table: tables.sql(f"SELECT * FROM {table} ORDER BY ALL").rows() for table in ("runs", "tasks", "joints")
        }
    shutil.rmtree(runs / "tables")
    for recording in runs.glob("*.mcap"):
        write_rows(recording)
        assert (runs / "tables" / "new" / f"{recording.name}.arrows").is_file()
    victim = min(runs.glob("*.mcap"))
    os.utime(victim, ns=(1, 1))  # these rows aren't of the file as it is now
    with Runs(runs) as tables:
        after = {table: tables.sql(f"SELECT * FROM {table} ORDER BY ALL").rows() for table in before}
    assert after == before
    assert list((runs / "tables" / "new").iterdir()) == []


KILLED_AFTER_3_KB = """\
import resource, signal, sys
from pathlib import Path
from replay.runs.rows import write_rows
signal.signal(signal.SIGXFSZ, signal.SIG_DFL)
resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
resource.setrlimit(resource.RLIMIT_FSIZE, (3000, 3000))
write_rows(Path(sys.argv[1]))
"""


def test_rows_of_which_a_kill_left_a_half_go(runs: Path) -> None:
    victim = min(runs.glob("*.mcap"))
    ended = subprocess.run([sys.executable, "-c", KILLED_AFTER_3_KB, victim], check=False)
    assert ended.returncode == -signal.SIGXFSZ
    (half,) = (runs / "tables" / "new").iterdir()
    assert half.stat().st_size == 3000
    with Runs(runs) as tables:
        assert tables.sql("SELECT count(*) FROM runs WHERE run = ?", [victim.name]).rows() == [(1,)]
    assert list((runs / "tables" / "new").iterdir()) == []


def test_a_killed_update_and_lost_tables_are_made_good(runs: Path) -> None:
    with Runs(runs) as tables:
        rows = tables.sql("SELECT count(*) FROM tasks").rows()
    (part,) = Folder(runs).tables.glob("0*")
    shutil.copytree(part, part.with_name("000002"))  # an update that ended before it was told in the contents
    shutil.copy2(min(runs.glob("*.mcap")), runs / "more.mcap")
    assert read(runs) == [1]
    (part / "tasks.parquet").unlink()
    with Runs(runs) as tables:
        assert tables.sql("SELECT count(*) FROM tasks WHERE run <> 'more.mcap'").rows() == rows


def test_tables_that_are_read_stay_while_others_bring_them_up_to_date(
    runs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(runs.parent)
    with Runs(runs.name) as reader:
        reader.sql("SELECT count(*) FROM runs")
        min(runs.glob("0*.mcap")).unlink()
        with Runs(runs) as newer:
            assert newer.sql("SELECT count(*) FROM runs").rows() == [(COUNT - 1,)]
        monkeypatch.chdir("/")
        assert reader.sql("SELECT count(DISTINCT run) FROM tasks").rows() == [(COUNT,)]
    min(runs.glob("0*.mcap")).unlink()
    with Runs(runs) as reader:
        assert len(list((runs / "tables").glob("0*"))) == 1, "what nobody reads any more is removed"
        shutil.rmtree(runs / "tables")
        with pytest.raises(NotRead, match="its tables were removed"):
            reader.sql("SELECT count(*) FROM joints")


def test_tables_that_are_up_to_date_need_not_be_writable(runs: Path) -> None:
    assert read(runs)[-1] == COUNT
    lock = runs / "tables" / ".lock"
    lock.unlink()
    lock.mkdir()  # as on a read-only disk, also for those who may write everything
    with Runs(runs) as tables:
        assert len(tables) == COUNT
    min(runs.glob("0*.mcap")).unlink()
    with pytest.raises(NotRead, match="can't be written"):
        Runs(runs)


def test_what_is_in_a_folder_of_somebody_elses_removes_nothing_outside_of_it(runs: Path, tmp_path: Path) -> None:
    precious = tmp_path / "precious"
    with Runs(runs):
        pass
    shutil.copytree(runs / "tables" / "000001", precious)
    contents = runs / "tables" / "contents.json"
    contents.write_text(contents.read_text().replace('"000001"', '"../../precious"'))
    min(runs.glob("0*.mcap")).unlink()
    with Runs(runs) as tables:
        assert len(tables) == COUNT - 1
    assert (precious / "runs.parquet").is_file()
    shutil.rmtree(runs / "tables")
    (runs / "tables").symlink_to(precious)
    with pytest.raises(NotRead, match="is a link"):
        Runs(runs)
    assert (precious / "runs.parquet").is_file()


def test_folders_may_have_any_name_and_answers_any_columns(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = runs.rename(runs.parent / "what[1]*? it's")
    assert main(["sql", str(folder), "SELECT count(*) AS n, 1.5 AS x, 2 AS n FROM runs", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == [{"n": COUNT, "x": 1.5, "n_1": 2}]


def test_what_is_no_run_is_named_and_left_out(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (runs / "notes.mcap").write_text("not a recording")
    whole = min(runs.glob("0*.mcap")).read_bytes()
    damaged = bytearray(whole)
    chunk = max(whole.rfind(magic) for magic in (b"\x28\xb5\x2f\xfd", b"\x04\x22\x4d\x18"))  # of zstd, lz4
    damaged[chunk + 8 : chunk + 40] = bytes(32)
    (runs / "bad.mcap").write_bytes(damaged)
    (runs / "models-0123456789ab.mcap").write_bytes(whole)
    (runs / ".00099.mcap").write_bytes(whole)
    shutil.copy2(GOLDEN, runs / "other.mcap")
    assert main(["stats", str(runs), "--json"]) == 3
    out, err = capsys.readouterr()
    found = json.loads(out)
    assert len(found["runs"]) == COUNT
    assert [each["name"] for each in found["skipped"]] == ["bad.mcap", "notes.mcap"]
    assert sum(found["others"].values()) == 1, "the recording of another plan is counted"
    assert "bad.mcap" in err
    assert "notes.mcap: isn't an MCAP file" in err


def test_newer_recordings_links_and_damaged_attachments(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, second, *rest = sorted(runs.glob("0*.mcap"))
    for file in rest:
        file.unlink()
    forge(runs / "newer.mcap")
    (runs / "linked.mcap").symlink_to(shutil.copy2(first, runs.parent / "elsewhere"))
    (runs / "dangling.mcap").symlink_to(runs / "nowhere")
    (runs / "loop.mcap").symlink_to(runs / "loop.mcap")
    with second.open("r+b") as file:
        summary = make_reader(file).get_summary()
        assert summary is not None
        attached = summary.attachment_indexes[0]
        file.seek(attached.offset + attached.length - 12)  # in its content, which ends before a checksum
        file.write(b"bent")
    assert main(["stats", str(runs), "--json"]) == 3
    found = json.loads(capsys.readouterr().out)
    assert found["runs"] == [first.name, "linked.mcap"]
    reasons = {each["name"]: each["reason"] for each in found["skipped"]}
    assert set(reasons) == {second.name, "dangling.mcap", "loop.mcap", "newer.mcap"}
    assert f"{attached.name} is damaged (its checksum differs)" in reasons[second.name]
    assert "written by PyCRAM 9.0.0, which is newer than this release" in reasons["newer.mcap"]


@pytest.mark.parametrize(
    "statement",
    [
        "COPY runs TO '{there}'",
        "SELECT * FROM read_text('{secret}')",
        "SELECT * FROM '{secret}'",
        "SELECT * FROM glob('{folder}/*')",
        "SELECT 1; DROP VIEW runs",
        "DROP VIEW runs",
        "INSERT INTO runs SELECT * FROM runs",
        "SET enable_external_access=true",
        "ATTACH '{there}'",
        "INSTALL httpfs",
        "EXPLAIN ANALYZE COPY runs TO '{there}'",
        "EXPORT DATABASE '{there}'",
        "SELECT nothing FROM runs",
        "not sql",
        "",
    ],
)  # fmt: skip
def test_sql_that_writes_or_reads_other_files_is_refused(runs: Path, tmp_path: Path, statement: str) -> None:
    secret, there = tmp_path / "secret.csv", tmp_path / "there"
    secret.write_text("a,b\n1,2\n")
    for file in sorted(runs.glob("*.mcap"))[2:]:
        file.unlink()
    with Runs(runs) as tables:
        with pytest.raises(Refused):
            tables.sql(statement.format(there=there, secret=secret, folder=tmp_path))
        assert tables.sql("SELECT count(*) FROM runs").rows() == [(2,)]
    assert not there.exists()


def test_answers_as_frames(runs: Path) -> None:
    with replay.open_runs(runs) as tables:
        answer = tables.sql("SELECT run, seconds FROM runs ORDER BY run")
        assert answer.to_arrow().column_names == ["run", "seconds"]
        assert answer.to_pandas()["run"].tolist() == answer.to_arrow()["run"].to_pylist()
        assert len(answer) == COUNT


@pytest.mark.long
@pytest.mark.needs("polars")
def test_answers_as_frames_of_polars(runs: Path) -> None:
    with replay.open_runs(runs) as tables:
        answer = tables.sql("SELECT run, seconds FROM runs ORDER BY run")
        assert answer.to_polars()["run"].to_list() == answer.to_arrow()["run"].to_pylist()


def test_verbs_of_one_recording_say_what_folders_have(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["tree", str(runs)]) == 2
    assert (
        "takes a single recording; verbs for folders are info, diff, why, check, view, export, sql, stats, separate"
        in capsys.readouterr().err
    )
    assert main(["stats", str(runs / "nowhere")]) == 2
    assert "there is no such folder" in capsys.readouterr().err


ENDLESS = "SELECT sum(a.range * b.range % 7) FROM range(100000000) a, range(100000000) b"


def test_ctrl_c_ends_a_statement_that_takes_long(runs: Path) -> None:
    with Runs(runs):
        pass
    program = (
        "import os, replay, signal, threading\n"
        f"with replay.open_runs({str(runs)!r}) as runs:\n"
        "    try:\n"
        "        threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT)).start()\n"
        f"        runs.sql({ENDLESS!r})\n"
        "    except KeyboardInterrupt:\n"
        "        print(runs.sql('SELECT count(*) FROM runs').rows())\n"
    )
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False)
    assert ended.stdout == f"[({COUNT},)]\n", ended.stderr
