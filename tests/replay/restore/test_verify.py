"""Verifying: sound recordings are, bit for bit; whatever was changed in one is found, where it is."""

from __future__ import annotations

import json
import random
import struct
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

import recorder
import replay
from pycram import bullet_world_reasoning as btr
from pycram.bullet_world import BulletWorld, Object
from pycram.failures import PlanFailure
from pycram.language import par
from recorder import mcap_sink
from recorder.mcap_sink import McapSink
from recorder.records import TOPICS, Keyframe, Mutation, Record, Task
from recorder.records.values import AssetFile
from recorder.tracing.span import span
from replay.cli.main import main
from replay.restore.verify import verify

if TYPE_CHECKING:
    from collections.abc import Callable

    from replay.state.integrity import Problem


CABINET = Path(__file__).parents[1] / "golden" / "cabinet.urdf"


pytestmark = pytest.mark.usefixtures("nothing_left")


def rewritten(source: Path, target: Path, change: Callable[[Record], Record | None], **metadata: str) -> Path:
    """A copy that is sound as a file, but in which records were changed, or left out where None is given."""
    with replay.open(source) as log:
        mcap_sink = McapSink(target, dict(log.metadata) | metadata)
        for name, content in log.assets.items():
            mcap_sink.attach(AssetFile(name.partition("/")[2], content))
        for record in log.records():
            kept = change(record)
            if kept is not None:
                mcap_sink.write(TOPICS[type(kept)], kept, kept.SerializeToString())
        mcap_sink.close()
    return target


def problem_of(file: Path) -> Problem:
    with replay.open(file) as log:
        problem = verify(log).problem
    assert problem is not None
    return problem


@pytest.fixture(scope="module")
def run_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plan with tasks, two worlds in turn, a chain of attachments, a drawer, removal and re-adding, keyframes."""
    file = tmp_path_factory.mktemp("verify") / "run.mcap"
    with recorder.record(file), BulletWorld(name="kitchen") as world, BulletWorld(name="other") as other:
        world.set_gravity([0, 0, -9.8])
        other.set_gravity([0, 0, -1.6])
        Object("floor", "environment", "plane.urdf", world=world)
        cabinet = Object("cabinet", "environment", str(CABINET), [1.3, 0.7, 0.6], world=world)
        spoon = Object("spoon", "spoon", "spoon.stl", [1.3, 0.7, 0.72], world=world)
        cup = Object("cup", "cup", "cup.stl", [1.3, 0.6, 1.0], world=world)
        apple = Object("apple", "apple", "apple.stl", [1.3, 0.6, 1.1], world=world)
        ball = Object("ball", "apple", "apple.stl", [0, 0, 3], world=other)
        with span("plan", "tidy"), span("plan", "open the drawer"):
            world.simulate(0.2)
            other.simulate(0.3)
            cabinet.set_joint_position("drawer_joint", 0.3)
            btr.supporting(cabinet, spoon)
            other.simulate(0.1)
            world.simulate(0.1)
        cabinet.attach(cup, "drawer")
        cup.attach(apple)
        cabinet.set_joint_position("drawer_joint", 0.1)
        cup.set_position([1.2, 0.7, 1.2])
        apple.get_AABB()
        world.simulate(0.2)
        spoon.remove()
        Object("spoon", "spoon", "spoon.stl", [1.4, 0.5, 0.9], world=world, color=[1, 0, 0, 1])
        for turn in range(110):  # past a keyframe
            ball.set_position([0.01 * turn, 0, 2])
        cup.detach(apple)
        apple.set_color([0, 0, 1, 1])
        world.simulate(0.1)
        world.reset()
        world.simulate(0.1)
    return file


def test_a_sound_recording_is_exact(run_log: Path) -> None:
    with replay.open(run_log) as log:
        verdict = verify(log)
        changes = sum(1 for _ in log.records(Mutation))
    assert verdict.exact, verdict
    assert (verdict.steps, verdict.worlds, verdict.tasks) == (len(log), 2, 2)
    assert verdict.keyframes >= 1
    assert verdict.changes == changes


def test_reading_poses_between_moves_changes_nothing(tmp_path: Path) -> None:
    """Where something touches, even a look at it could leave contacts behind that a moment later are wrong."""
    with recorder.record(tmp_path / "run.mcap"), BulletWorld() as world:
        world.set_gravity([0, 0, -9.8])
        floor = Object("floor", "environment", "plane.urdf")
        bowl = Object("bowl", "bowl", "bowl.stl", [0, 0, 0.04])
        world.simulate(0.3)
        x, y, z = bowl.get_position()
        bowl.set_position([x + 0.004, y, z - 0.001])
        bowl.get_AABB()
        btr.stable(bowl)
        btr.supporting(floor, bowl)
        btr.visible(bowl, [1, 0, 1])
        bowl.set_position([x, y, z])
        world.simulate(0.3)
    with replay.open(tmp_path / "run.mcap") as log:
        verdict = verify(log)
    assert verdict.exact, verdict


@pytest.mark.slow
def test_the_demos_are_exact(demo_log: Path, failed_log: Path) -> None:
    for file in (demo_log, failed_log):
        with replay.open(file) as log:
            verdict = verify(log)
        assert verdict.exact, verdict
        assert verdict.steps == len(log)


def effects(file: Path, kind: str) -> list[int]:
    with replay.open(file) as log:
        return [r.seq for r in log.records(Mutation) if r.WhichOneof("command") == kind and r.effect.bodies]


@pytest.mark.parametrize("command", ["simulate", "move_body", "move_joints", "load_body"])
def test_one_wrong_byte_of_a_pose_is_found(run_log: Path, tmp_path: Path, command: str) -> None:
    """The last byte of one number of one pose, in a file with right sums: it is found, at that step."""
    step = random.Random(command).choice(effects(run_log, command))

    def tamper(record: Record) -> Record:
        if record.seq == step and isinstance(record, Mutation):
            numbers = next(b.position for b in record.effect.bodies if b.position)
            numbers[1] = flipped(numbers[1])
        return record

    problem = problem_of(rewritten(run_log, tmp_path / "x.mcap", tamper))
    assert problem.step == step
    assert problem.deviation is not None
    assert problem.deviation.field.endswith(".position[1]")
    assert 0 < problem.deviation.size < 1e-12


def flipped(number: float) -> float:
    """The number with its lowest bit turned."""
    bits = struct.unpack("<Q", struct.pack("<d", number))[0] ^ 1
    turned: float = struct.unpack("<d", struct.pack("<Q", bits))[0]
    return turned


def tampered_sample(record: Record) -> int | None:
    if isinstance(record, Mutation) and record.effect.samples and record.effect.samples[0].bodies[0].position:
        record.effect.samples[0].bodies[0].position[2] += 1e-9
        return record.seq
    return None


def tampered_attachment(record: Record) -> int | None:
    if isinstance(record, Mutation) and record.effect.attached:
        record.effect.attached[0].position[0] += 1e-9
        return record.seq
    return None


def tampered_command(record: Record) -> int | None:
    if isinstance(record, Mutation) and record.HasField("move_body"):
        record.move_body.position[0] += 1e-3
        return record.seq
    return None


def tampered_keyframe(record: Record) -> int | None:
    if isinstance(record, Keyframe):
        record.bodies[0].position[0] += 1e-9
        return record.seq
    return None


def tampered_task(record: Record) -> int | None:
    if isinstance(record, Task) and record.phase == Task.FINISHED:
        record.task += 1000
        return record.seq
    return None


def tampered_time(record: Record) -> int | None:
    if isinstance(record, Mutation):
        record.wall_time_ns -= 10**12
        return record.seq
    return None


@pytest.mark.parametrize(
    ("tamper", "cause"),
    [
        (tampered_sample, "another effect"),
        (tampered_attachment, "another effect"),
        (tampered_command, "another effect"),
        (tampered_keyframe, "differs from the fold of the previous records"),
        (tampered_task, "never started"),
        (tampered_time, "wall time"),
    ],
)
def test_every_manipulation_is_found_at_its_step(
    run_log: Path, tmp_path: Path, tamper: Callable[[Record], int | None], cause: str
) -> None:
    steps: list[int] = []

    def change(record: Record) -> Record:
        if not steps:
            step = tamper(record)
            steps.extend([] if step is None else [step])
        return record

    problem = problem_of(rewritten(run_log, tmp_path / "x.mcap", change))
    assert cause in problem.cause
    assert [problem.step] == steps


def test_a_problem_names_its_task(run_log: Path, tmp_path: Path) -> None:
    def change(record: Record) -> Record:
        if isinstance(record, Mutation) and record.HasField("move_joints") and record.task:
            record.effect.bodies[0].joint_positions[0] += 1e-6
        return record

    problem = problem_of(rewritten(run_log, tmp_path / "x.mcap", change))
    assert problem.task == ("tidy", "open the drawer")
    assert problem.deviation is not None
    assert problem.deviation.size == pytest.approx(1e-6)


def test_a_removed_record_is_reported(run_log: Path, tmp_path: Path) -> None:
    for step in (10, 60):
        file = rewritten(run_log, tmp_path / f"{step}.mcap", lambda r, gone=step: None if r.seq == gone else r)
        problem = problem_of(file)
        assert problem.step == step
        assert "is missing" in problem.cause
        assert main(["verify", str(file)]) == 3


def test_tasks_that_never_end_are_found_unless_the_process_was_killed(run_log: Path, tmp_path: Path) -> None:
    ends: list[int] = []

    def running_on(record: Record) -> Record | None:
        if isinstance(record, Task) and record.phase == Task.FINISHED:
            ends.append(record.seq)
            return None
        record.seq -= len(ends)
        return record

    problem = problem_of(rewritten(run_log, tmp_path / "x.mcap", running_on))
    assert "the run ends before task" in problem.cause
    cut = tmp_path / "cut.mcap"
    content = run_log.read_bytes()
    cut.write_bytes(content[: int(len(content) * 0.97)])
    assert main(["verify", str(cut)]) == 3


def test_a_branch_without_end_is_found(tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    with recorder.record(file), par as block:
        block(lambda: None)
    with replay.open(file) as log:
        end = next(r.seq for r in log.records(Task) if r.kind == "branch" and r.phase == Task.FINISHED)

    def without_end(record: Record) -> Record | None:
        kept = record.seq != end
        record.seq -= record.seq > end
        return record if kept else None

    assert "the run ends before task" in problem_of(rewritten(file, tmp_path / "x.mcap", without_end)).cause


def test_an_exchanged_attached_file_is_found(run_log: Path, tmp_path: Path) -> None:
    target = tmp_path / "x.mcap"
    content = bytearray(run_log.read_bytes())
    at = content.index(b"<robot")
    content[at + 40] ^= 1
    target.write_bytes(content)
    with replay.open(target) as log:
        verdict = verify(log)
    assert not verdict.sound
    assert "the attached file" in verdict.damage
    assert main(["verify", str(target)]) == 3


@pytest.mark.slow
def test_in_another_environment_the_largest_deviation_is_reported(run_log: Path, tmp_path: Path) -> None:
    """Where the engine isn't the same, the last bits say nothing; but what is far off is a problem still."""

    def nudge(size: float) -> Callable[[Record], Record]:
        def change(record: Record) -> Record:
            if isinstance(record, Mutation) and record.HasField("simulate"):
                for body in record.effect.bodies:
                    if body.body == "ball" and body.position:
                        body.position[0] += size
            return record

        return change

    same = rewritten(run_log, tmp_path / "same.mcap", lambda record: record, pybullet="3.2.5")
    with replay.open(same) as log:
        verdict = verify(log)
    assert verdict.exact
    assert verdict.environment == (f"pybullet {mcap_sink.versions()['pybullet']} instead of 3.2.5",)
    with replay.open(rewritten(run_log, tmp_path / "near.mcap", nudge(1e-5), pybullet="3.2.5")) as log:
        verdict = verify(log)
    assert verdict.sound
    assert not verdict.exact
    assert verdict.largest is not None
    assert verdict.largest.size == pytest.approx(1e-5)
    assert main(["verify", str(tmp_path / "near.mcap")]) == 0
    problem = problem_of(rewritten(run_log, tmp_path / "far.mcap", nudge(0.1), pybullet="3.2.5"))
    assert "the environment is different" in problem.cause


def test_worlds_from_before_the_recording_are_compared_without_physics(tmp_path: Path) -> None:
    file = tmp_path / "late.mcap"
    with BulletWorld(name="early") as world:
        world.set_gravity([0, 0, -9.8])
        Object("floor", "environment", "plane.urdf")
        bowl = Object("bowl", "bowl", "bowl.stl", [0, 0, 0.2])
        cup = Object("cup", "cup", "cup.stl", [0.02, 0, 0.4])
        world.simulate(0.3)
        with recorder.record(file):
            world.simulate(0.3)
            bowl.attach(cup)
            bowl.set_position([1, 0, 1])
            world.simulate(0.3)
            cup.set_position([0, 0, 1])
    with replay.open(file) as log:
        verdict = verify(log)
    assert verdict.sound, verdict
    assert verdict.late == ("early",)
    assert not verdict.exact
    moves = effects(file, "move_body")

    def tamper(record: Record) -> Record:
        if record.seq == moves[-1] and isinstance(record, Mutation):
            record.effect.bodies[0].position[0] += 1e-3
        return record

    assert problem_of(rewritten(file, tmp_path / "x.mcap", tamper)).step == moves[-1]


def fail_halfway(world: BulletWorld, bowls: list[Object]) -> None:
    with span("plan", "fails"), par:
        for bowl in bowls:
            bowl.set_position([0, 1, 0.5])
            world.simulate(0.05)
        raise PlanFailure


def test_real_time_branches_and_failures_are_executed_again(tmp_path: Path) -> None:
    """What the clock and branches of a plan did is on record in the order in which it happened."""
    file = tmp_path / "run.mcap"
    with recorder.record(file), BulletWorld() as world:
        world.set_gravity([0, 0, -9.8])
        Object("floor", "environment", "plane.urdf")
        bowls = [Object(f"bowl{i}", "bowl", "bowl.stl", [i, 0, 0.3]) for i in range(3)]
        world.set_realtime(True)
        while world.sim_step < 24:
            bowls[0].set_position([0, 0, 0.3])
        world.set_realtime(False)
        with pytest.raises(PlanFailure):
            fail_halfway(world, bowls)
    with replay.open(file) as log:
        verdict = verify(log)
    assert verdict.exact, verdict


@pytest.mark.slow
def test_the_verb_prints_a_verdict(run_log: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["verify", str(run_log)]) == 0
    output = capfd.readouterr()
    assert "bit for bit" in output.out
    assert not output.err
    assert main(["verify", str(run_log), "--json"]) == 0
    verdict = json.loads(capfd.readouterr().out)
    assert verdict["sound"]
    assert verdict["exact"]
    assert verdict["problem"] is None

    def tamper(record: Record) -> Record:
        if isinstance(record, Keyframe):
            record.gravity[2] = -3
        return record

    wrong = rewritten(run_log, tmp_path / "x.mcap", tamper)
    assert main(["verify", str(wrong)]) == 1
    text = capfd.readouterr().out
    assert text.startswith("not sound: step ")
    assert ".gravity[2]: recorded -3.0, found -" in text
    assert main(["verify", str(wrong), "--json"]) == 1
    assert json.loads(capfd.readouterr().out)["problem"]["deviation"]["recorded"] == -3.0
