"""What commands print on a terminal, in pipes and into pagers, and what shells complete."""

from __future__ import annotations

import fcntl
import os
import pty
import re
import select
import shlex
import shutil
import struct
import subprocess
import sys
import termios
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from pycram.cli import EXAMPLES, main as pycram, options_parser
from replay.cli import cheat
from replay.cli.main import VERBS, _parser, main

if TYPE_CHECKING:
    from collections.abc import Callable

GOLDEN = Path(__file__).parents[1] / "golden"
FAILED, FINE = (GOLDEN / "demos" / f"0.1.0-{name}.mcap" for name in ("fails_to_reach", "set_the_table"))
PAGE = (Path(__file__).parents[3] / "docs" / "reference" / "command_line.md").read_text(encoding="utf-8")
COLOUR = re.compile(r"\x1b\[\d*m")
ENVIRONMENT = {key: value for key, value in os.environ.items() if key not in ("NO_COLOR", "FORCE_COLOR", "PAGER")}
REPLAY = [sys.executable, "-m", "replay"]


def on_terminal(command: list[str], lines: int = 1000, keys: str = "", **environment: str) -> str:
    """Return what a command prints on a terminal of some lines."""
    leader, follower = pty.openpty()
    fcntl.ioctl(follower, termios.TIOCSWINSZ, struct.pack("HHHH", lines, 200, 0, 0))
    given = ENVIRONMENT | {"TERM": "xterm"} | environment
    process = subprocess.Popen(command, stdin=follower, stdout=follower, stderr=follower, env=given)
    os.close(follower)
    os.write(leader, keys.encode())
    printed = b""
    try:
        while select.select([leader], [], [], 60)[0]:
            printed += os.read(leader, 1 << 16)
    except OSError:  # the command has ended
        pass
    os.close(leader)
    assert process.wait(60) == 0
    return printed.decode().replace("\r\n", "\n")


def in_pipe(command: list[str], **environment: str) -> str:
    """Return what a command prints into a pipe."""
    return subprocess.run(
        command, stdout=subprocess.PIPE, text=True, env=ENVIRONMENT | environment, check=True, encoding="utf-8"
    ).stdout


@pytest.mark.slow
@pytest.mark.parametrize("verb", ["info", "why", "tree", "log", "state last"])
def test_a_terminal_gets_the_text_of_a_pipe_in_colours(verb: str) -> None:
    name, *rest = verb.split()
    command = [*REPLAY, name, str(FAILED), *rest]
    plain, shown = in_pipe(command), on_terminal(command)
    assert "\x1b" not in plain
    assert COLOUR.sub("", shown) == plain
    if name != "state":
        assert "\x1b[31mfailed\x1b[0m" in shown or "\x1b[31mX" in shown or "\x1b[31m> X" in shown


@pytest.mark.slow
def test_no_color_and_force_color_are_respected() -> None:
    command = [*REPLAY, "info", str(FAILED)]
    plain = in_pipe(command)
    assert on_terminal(command, NO_COLOR="1") == plain
    assert on_terminal(command, TERM="dumb") == plain
    assert in_pipe(command, NO_COLOR="1", FORCE_COLOR="1") == plain
    forced = in_pipe(command, FORCE_COLOR="1")
    assert forced != plain
    assert COLOUR.sub("", forced) == plain
    assert "\x1b" not in in_pipe([*command, "--json"], FORCE_COLOR="1")


@pytest.mark.slow
def test_only_output_that_is_longer_than_the_screen_is_paged(tmp_path: Path) -> None:
    pager = tmp_path / "pager"
    pager.write_text(f'#!/bin/sh\necho "paged with LESS=$LESS"\ncat > {tmp_path}/page\n')
    pager.chmod(0o755)
    command = [*REPLAY, "info", str(FAILED)]
    assert "paged" not in on_terminal(command, PAGER=str(pager))
    assert on_terminal(command, lines=5, PAGER=str(pager)) == "paged with LESS=-RFX\n"
    assert COLOUR.sub("", (tmp_path / "page").read_text()) == in_pipe(command)
    without = on_terminal(command, lines=5, PAGER=str(tmp_path / "missing"))
    assert COLOUR.sub("", without) == in_pipe(command)


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("less") is None, reason="less isn't installed")
def test_quitting_the_pager_ends_the_command_well() -> None:
    shown = on_terminal([*REPLAY, "log", str(FINE)], lines=10, keys="q")
    assert "Traceback" not in shown
    assert "mutation" in shown
    assert shown.count("\n") < 40


# --- help -------------------------------------------------------------------------------------------------------------


def test_each_verb_has_two_examples_that_parse(capsys: pytest.CaptureFixture[str]) -> None:
    listed = {line.split()[0] for lines in cheat.SHEET.values() for line in lines.splitlines()}
    assert listed == set(VERBS)
    for verb in VERBS:
        examples = [command for command, _ in cheat.examples(verb)]
        assert len(set(examples)) == 2
        main([verb, "--help"])
        shown = capsys.readouterr().out
        for example in examples:
            assert example in shown
            _parser([verb]).parse_args(words(example)[1:])


def words(command: str) -> list[str]:
    return [word.replace("-20", "last") for word in shlex.split(command)]  # main joins negative steps to their options


@pytest.mark.parametrize("verb", ["info", "tree", "log", "show", "source", "why", "blame", "diff", "state"])
def test_examples_of_reading_verbs_run(
    verb: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "run.mcap").symlink_to(FAILED)
    (tmp_path / "other.mcap").symlink_to(FAILED)
    for command, _ in cheat.examples(verb):
        given = [word.replace("12.5s", "0.2s") for word in command.split()[1:]]
        if "runs/" not in given:
            code = main(given)
            assert code == 0 or verb == "diff", capsys.readouterr().err
            assert capsys.readouterr().out


@pytest.mark.parametrize("columns", [80, 200])
def test_no_line_of_help_is_wider_than_the_terminal(
    columns: int, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    for verb in VERBS:
        main([verb, "--help"])
    for command in EXAMPLES:
        with pytest.raises(SystemExit):
            pycram([command, "--help"])
    shown = capsys.readouterr().out.splitlines()
    assert max(map(len, shown)) <= columns
    assert any(re.search(r"^  pycram\S* .*?\S  +\S", line) for line in shown)  # still in columns where they fit


def test_each_command_of_pycram_has_two_examples_that_parse(capsys: pytest.CaptureFixture[str]) -> None:
    for command, examples in EXAMPLES.items():
        with pytest.raises(SystemExit):
            pycram([command, "--help"])
        shown = capsys.readouterr().out
        assert len(examples) == 2
        for arguments, _ in examples:
            assert f"pycram {command} {arguments}".rstrip() in shown
            options_parser().parse_args([command, *arguments.split()])


def test_the_cheat_sheet_has_all_verbs_and_names_of_steps(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["cheat"]) == 0
    sheet = capsys.readouterr().out
    assert all(f"  pycram-replay {verb} " in sheet for verb in VERBS)
    assert "task:pick-up@end" in sheet
    assert max(map(len, sheet.splitlines())) <= 120


def test_without_arguments_the_verbs_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 2
    shown = capsys.readouterr().err
    assert all(re.search(rf"^    {verb}\s", shown, re.MULTILINE) for verb in [*VERBS, "cheat"])
    assert pycram([]) == 2
    assert "run a plan many times" in capsys.readouterr().err


@pytest.mark.parametrize(("file", "verb"), [(FAILED, "why"), (FINE, "log")])
def test_a_recording_alone_is_summarised_with_next_steps(
    file: Path, verb: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["info", str(file)]) == 0
    summary = capsys.readouterr().out
    assert main([str(file)]) == 0
    shown = capsys.readouterr().out
    assert shown.startswith(summary)
    steps = [line.split()[1:] for line in shown.removeprefix(summary).splitlines() if "pycram-replay" in line]
    assert verb in [step[0] for step in steps]
    for step in steps:
        if step[0] != "view":
            assert main(step) == 0


# --- suggestions ------------------------------------------------------------------------------------------------------


def test_wrong_commands_and_files_get_suggestions(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "breakfast.mcap").symlink_to(FINE)
    (tmp_path / "breakfast.py").touch()
    (tmp_path / "robots").mkdir()
    (tmp_path / "robots" / "my_robot.urdf").touch()

    def told(call: Callable[[list[str]], int], *arguments: str) -> str:
        with pytest.raises(SystemExit) as end:
            sys.exit(call(list(arguments)))
        assert end.value.code == 2
        return capsys.readouterr().err.splitlines()[-1]

    assert told(pycram, "rnu", "x.py").endswith("; did you mean run?")
    assert "; did you mean set_the_table" in told(pycram, "demo", "set_the_tabel")
    assert told(pycram, "run", "brekfast.py").endswith("brekfast.py: no such plan; did you mean breakfast.py?")
    assert told(pycram, "describe", "kitchn.urdf").endswith("kitchn.urdf: no such file; did you mean kitchen.urdf?")
    assert told(pycram, "describe", "robots/myrobot.urdf").endswith("; did you mean robots/my_robot.urdf?")
    assert told(main, "inof", "breakfast.mcap").endswith("did you mean info?")
    for arguments in (["info", "brekfast.mcap"], ["brekfast.mcap"]):
        assert told(main, *arguments).endswith("No such file or directory; did you mean breakfast.mcap?")
    assert "did you mean" not in told(main, "info", "zzz.mcap")


# --- completion -------------------------------------------------------------------------------------------------------


def completions(line: str, folder: Path) -> list[str]:
    """Return what bash offers for a command line."""
    file = folder / "completions"
    environment = ENVIRONMENT | {
        "_ARGCOMPLETE": "1",
        "_ARGCOMPLETE_IFS": "\n",
        "_ARGCOMPLETE_STDOUT_FILENAME": str(file),
        "COMP_LINE": line,
        "COMP_POINT": str(len(line)),
        "PYCRAM_CACHE": str(folder / ".cache"),
    }
    module = "pycram" if line.startswith("pycram ") else "replay"
    ended = subprocess.run([sys.executable, "-m", module], env=environment, cwd=folder, capture_output=True, check=True)
    assert not ended.stdout
    return file.read_text().split()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("line", "offered", "others"),
    [
        ("pycram-replay ", ["info", "why", "cheat"], ["run.mcap", "--help"]),
        ("pycram-replay in", ["info"], ["log"]),
        ("pycram-replay log --", ["--kind", "--object", "--json"], ["--answers"]),
        ("pycram-replay log run.mcap --kind m", ["mutation"], ["task"]),
        ("pycram-replay info ", ["run.mcap", "runs/"], ["plan.py"]),
        ("pycram-replay info r", ["run.mcap", "runs/"], []),
        ("pycram-replay state run.mcap ", ["last", "failure", "task:pick-up@start"], []),
        ("pycram-replay state run.mcap last m", ["milk"], ["pr2"]),
        ("pycram-replay log run.mcap --object ", ["milk", "pr2", "kitchen"], []),
        ("pycram-replay log run.mcap --task pick", ["pick-up"], []),
        ("pycram-replay log run.mcap --world ", ["world_1"], []),
        ("pycram-replay blame run.mcap pr2.torso", ["pr2.torso_lift_joint"], []),
        ("pycram-replay state missing.mcap ", [], ["last"]),
        ("pycram ", ["run", "demo", "sweep", "describe", "tutorial"], []),
        ("pycram run ", ["plan.py", "runs/"], ["run.mcap"]),
        ("pycram run plan.py --mo", ["--motion"], []),
        ("pycram demo --robot p", ["pr2", "panda"], ["ur5"]),
    ],
)
def test_shells_complete_verbs_options_files_and_recorded_names(
    line: str, offered: list[str], others: list[str], tmp_path: Path
) -> None:
    (tmp_path / "run.mcap").symlink_to(FAILED)
    (tmp_path / "plan.py").touch()
    (tmp_path / "runs").mkdir()
    found = completions(line, tmp_path)
    assert sorted(completions(line, tmp_path)) == sorted(found)  # from the cache
    assert set(offered) <= set(found)
    assert not set(others) & set(found)
    assert offered or not found


@pytest.mark.slow
def test_bash_completes_with_the_documented_line(tmp_path: Path) -> None:
    setup = re.findall(r"`(eval .*?)`", PAGE)[0]
    scripts = Path(sys.executable).parent
    script = f"""{setup}
COMP_LINE='pycram-replay wh' COMP_POINT=16 COMP_TYPE=9
_python_argcomplete pycram-replay wh pycram-replay
echo "${{COMPREPLY[@]}}"
complete -p pycram pycram-replay
"""
    given = ENVIRONMENT | {"PATH": f"{scripts}:{os.environ['PATH']}"}
    shown = subprocess.run(["bash", "-c", script], env=given, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert shown.stdout.splitlines()[0].strip() == "why"
    assert shown.stdout.count("-F _python_argcomplete") == 2


def test_the_page_shows_the_help_and_the_cheat_sheet_that_are_printed(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    for command in (["why", "--help"], ["cheat"]):
        assert main(command) == 0
        assert f"\n{capsys.readouterr().out}```" in PAGE


# --- progress ---------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["run", "--explore", "3", "plan.py"], "pycram: 1 of 3 orders"),
        (["sweep", "plan.py", "--runs", "3", "-j", "1", "-o", "runs"], "pycram: 2 of 3 runs, 0 failed"),
    ],
)
def test_progress_is_printed_in_lines_where_there_is_no_terminal(
    arguments: list[str], line: str, tmp_path: Path
) -> None:
    (tmp_path / "plan.py").touch()

    def messages(period: float) -> list[str]:
        shutil.rmtree(tmp_path / "runs", ignore_errors=True)
        program = "import sys, recorder.terminal as t; t.PERIOD = {}; import pycram.cli; sys.exit(pycram.cli.main({}))"
        command = [sys.executable, "-c", program.format(period, [*arguments])]
        ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, env=ENVIRONMENT, check=True)
        return ended.stderr.splitlines()

    assert line in messages(period=0)
    assert not [each for each in messages(period=600) if " of 3 " in each]
