"""``cheat``: a page with examples of all verbs. The help of each verb shows its examples."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from replay.cli.console import print_text

#: Examples by heading: a verb, its arguments, and after # the result.
SHEET: Final = {
    "What happened": """\
info run.mcap  # summary: plan, outcome, worlds, versions
info runs/  # summary of a folder of recordings
tree run.mcap  # the task tree, with the path to the failure
tree run.mcap --at failure  # the task tree at the failure
log run.mcap --object milk --kind mutation  # all changes of the milk
log run.mcap --from -20  # the last 20 records
show run.mcap failure  # the whole record of the failure
show run.mcap 12 --json  # the record of step 12 as JSON
source run.mcap  # the recorded source files
source run.mcap -o source/  # write the source files into a folder
view run.mcap --at failure  # the scene in the Rerun viewer
view run.mcap --web  # the same in the browser
""",
    "Why": """\
why run.mcap  # why the plan failed
why run.mcap task:pick-up@end  # why this task failed
report run.mcap -o run.html  # a page to send, with pictures and a film
report run.mcap --good good.mcap  # the same, compared with a good run
check run.mcap 'never contact(pr2, kitchen)'  # whether a property holds; if not, where
check runs/ -f table.properties  # in how many runs each property holds
blame run.mcap milk  # the last change of the milk, and its cause
blame run.mcap pr2.torso_lift_joint --at 100  # the last change of a joint until step 100
diff run.mcap 10 failure  # what changed between two steps
diff run.mcap other.mcap  # the first difference between two runs
""",
    "At a step": """\
state run.mcap failure  # poses and attachments at the failure
state run.mcap 12.5s pr2  # the robot's joints at 12.5 s
ask run.mcap 156  # repeat the query of that step
ask run.mcap 100 'stable(milk)'  # another query at step 100
render run.mcap failure -o failure.png  # a picture of the failure
render run.mcap 100 150 200 -o film/  # three moments, from one viewpoint
restore run.mcap failure --shell  # the live world in a Python shell
restore run.mcap 100 --script test.py  # a script in the world of step 100
""",
    "Run it again": """\
verify run.mcap  # repeat every change, and compare the effects
verify run.mcap --static  # check only the file and its records
retrace run.mcap  # run the plan again, and compare the records
retrace run.mcap --plan new.py  # the same with an edited plan
fork run.mcap --at 100 --set milk.position=1.3,0.9,0.95  # continue with the milk in another place
fork run.mcap --plan new.py  # continue with an edited plan
debug run.mcap  # a debugger that also steps back
debug run.mcap task:pick-up@start  # a debugger at the start of a task
fix run.mcap  # the smallest edit that repairs the plan
fix run.mcap --apply  # the same, and write it into the plan
last-chance run.mcap  # the last step with a way to success
last-chance run.mcap --budget 20  # the same, in at most 20 runs
minimise run.mcap  # a smaller plan with the same failure
minimise run.mcap -o small.py --budget 50  # the same, in at most 50 runs
test run.mcap -o test_plan.py  # a pytest that fails until a repair
test run.mcap failure -o test_x.py  # a pytest of the failed motion in its scene
resume run.mcap  # continue a plan whose process was killed
resume run.mcap -o rest.mcap  # the same, recorded into rest.mcap
""",
    "Many runs": """\
stats runs/  # success rates, causes of failures, slow parts
stats runs/ --html report.html  # a report with plots and pictures
separate runs/  # facts that separate failures from successes
separate runs/ --cause 1  # the same for one cause of failures
sql runs/ --schema  # the tables and their columns
sql runs/ 'select outcome, count(*) from runs group by 1'  # a query
export run.mcap --to foxglove fox.mcap  # scene, tasks and log for Foxglove
export runs/ --to lerobot dataset --succeeded  # successful runs as a data set
""",
    "Files": """\
repair run.mcap  # copy the readable parts
repair run.mcap -o sound.mcap  # the same into sound.mcap
pack runs/00001.mcap  # copy a sweep's recording with its models
pack runs/00001.mcap -o run.mcap  # the same into run.mcap
""",
}
_STEPS: Final = """
Steps
  120, -1, last     a number; negative numbers count from the end
  failure           the step that why explains
  12.5s             a simulated time
  task:pick-up@end  start or end of a task; task:pick-up#2@start is the second one
"""


def examples(verb: str) -> Iterator[tuple[str, str]]:
    """Yield the examples of a verb: commands and their results."""
    for command, result in (each for lines in SHEET.values() for each in _parsed(lines)):
        if command.split()[1] == verb:
            yield command, result


def _parsed(lines: str) -> Iterator[tuple[str, str]]:
    for line in lines.splitlines():
        command, _, result = line.partition("  # ")
        yield f"pycram-replay {command}", result


def print_sheet() -> None:
    """Print the cheat sheet."""
    width = max(len(command) for lines in SHEET.values() for command, _ in _parsed(lines))
    for heading, lines in SHEET.items():
        print_text("\n".join([heading, *[f"  {command:{width}}  {result}" for command, result in _parsed(lines)], ""]))
    print_text(_STEPS.strip())
