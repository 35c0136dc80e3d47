"""``insdvl-replay demo``. Slow imports wait until there is work to do."""

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from insdvl_replay.cli import options as opt
from insdvl_replay.cli.messages import write_stdout
from insdvl_replay.core.errors import visible

if TYPE_CHECKING:
    from insdvl_replay.batch.demo import Question

_NEXT: Final = """
With your own logs (MCAP, bags, tables, files of instruments):
  insdvl-replay run dive.mcap                                 finds the settings and replays it
  insdvl-replay run dives/*.mcap --against dvl.scale=1.01     says whether a change helped
  insdvl-replay calibrate dives/*.mcap -o calibrated.toml     finds how the DVL is built in
"""


def demo(
    output: Annotated[
        Path,
        typer.Option("-o", "--output", metavar="DIR", help="Folder for the dives and results."),
    ] = Path("demo"),
    jobs: opt.Jobs = 1,
    verbose: opt.Verbose = 0,
    color: opt.Colored = "auto",
) -> None:
    """Show on simulated dives how changes of settings are judged: one helps, one does harm, one does nothing.

    It simulates six dives of 400 s and replays each before and after every change, which takes about a minute. No
    files are needed. Each answer has a page.

    \b
    Example:
      insdvl-replay demo --jobs 2
      insdvl-replay demo -o trial
    """
    from insdvl_replay.batch.demo import DIVES, DURATION_S, QUESTIONS, demo_answers, make_dives
    from insdvl_replay.changes.comparison_document import answer_lines
    from insdvl_replay.cli.screen import compiling, printed, progress, replaying
    from insdvl_replay.document.text import for_terminal

    number = 0

    def begin(question: "Question") -> None:
        nonlocal number
        number += 1
        remark = compiling() if number == 1 else ""
        _say(f"{number} of {len(QUESTIONS)}: {question.text}{remark}")
        _say(f"  $ {shlex.join(question.command(output))}")

    _say(f"simulating {len(DIVES)} dives of {DURATION_S:g} s: {output / 'dives'}")
    with progress("simulating"):
        make_dives(output)
    how = replaying(jobs, None, force=True, rerun=False, quiet=True)
    pages = []
    for answer in demo_answers(output, how, begin):
        write_stdout(printed(for_terminal(answer_lines(answer.found.answers))))
        pages.append(str(answer.page))
    _say(f"pages: {' '.join(pages)}")
    write_stdout(_NEXT)


def _say(line: str) -> None:
    write_stdout(f"{visible(line)}\n")
