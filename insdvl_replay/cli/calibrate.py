"""``insdvl-replay calibrate``."""

from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from insdvl_replay.cli.options import (
    AllowCode,
    AllowDamaged,
    Colored,
    ConfigFiles,
    Force,
    Format,
    Logs,
    OneDive,
    Preset,
    Settings,
    Verbose,
)

if TYPE_CHECKING:
    from insdvl_replay.calibration.innovations import ReadDive
    from insdvl_replay.core.config import Config


Delays = Literal["each", "one"]
Mounting = Literal["known", "unknown"]


def calibrate(
    logs: Logs,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="FILE", help="Write what is found as settings for -c.")
    ] = None,
    page_file: Annotated[
        Path | None, typer.Option("--page", metavar="FILE", help="Write it with pictures as one HTML page.")
    ] = None,
    config: ConfigFiles = [],  # noqa: B006
    preset: Preset = None,
    settings: Settings = [],  # noqa: B006
    only: Annotated[
        str | None,
        typer.Option(
            metavar="NAMES", help="Of arm, mounting, delay, scale and noise, with commas; left out, all of them."
        ),
    ] = None,
    reference: Annotated[
        bool, typer.Option("--reference", help="Hold it against the dives' references, and calibrate these, too.")
    ] = False,
    delays: Annotated[Delays, typer.Option("--delays", help="Whether each dive has a delay of its own.")] = "each",
    mounting: Annotated[Mounting, typer.Option("--mounting", help="If it is unknown, 24 are tried first.")] = "known",
    hold_out: Annotated[
        list[str],
        typer.Option(
            "--hold-out", metavar="SHARE|DIVE", help="Dives to try it on that are not fitted: a share, or names."
        ),
    ] = [],  # noqa: B006
    format_: Annotated[Format, typer.Option("--format", help="How it is printed.")] = "table",
    allow_damaged: AllowDamaged = False,
    allow_code: AllowCode = False,
    one_dive: OneDive = False,
    force: Force = False,
    verbose: Verbose = 0,
    color: Colored = "auto",
) -> int:
    """Estimate where the DVL sits, how it is turned, how late and how long it reads, and how noisy the sensors are.

    The dives' own innovations say it, without a reference, as far as the vehicle turned and changed its speed. What
    they do not show stays as it is. Nothing is applied: -o writes settings that `run -c` reads. The exit code is 0 if
    something was estimated, and 3 if nothing was or a log cannot be used.

    \b
    Example:
      insdvl-replay calibrate dives/*.mcap -c vehicle.toml -o calibrated.toml
      insdvl-replay run dives/*.mcap -c vehicle.toml -c calibrated.toml
      insdvl-replay calibrate dives/*.mcap -c vehicle.toml --hold-out 0.3 --page found.html
      insdvl-replay calibrate dives/*.mcap -c vehicle.toml --reference -o calibrated.toml
      insdvl-replay calibrate archive --only arm,delay --mounting unknown
    """
    from insdvl_replay.calibration.calibration import calibrate as calibrated
    from insdvl_replay.calibration.calibration import held_out_row
    from insdvl_replay.calibration.fit import likeliest_mounting, possible_axes, with_mounting
    from insdvl_replay.calibration.output import calibration_figures, calibration_result, calibration_toml
    from insdvl_replay.calibration.parameters import ALL_GROUPS, REFERENCE_GROUPS, Geometry
    from insdvl_replay.calibration.reference import with_reference
    from insdvl_replay.cli.messages import log_notes, log_to_stderr, write_stdout
    from insdvl_replay.cli.screen import compiling, steps_bar, written
    from insdvl_replay.core.config_file import load_config
    from insdvl_replay.core.errors import ConfigError, LogError, require_known
    from insdvl_replay.core.runtime import track_progress
    from insdvl_replay.results.folder import require_replaceable_file, result_file
    from insdvl_replay.show.render import render

    resolved = load_config(preset, config, settings, allow_code=allow_code)
    known_groups = REFERENCE_GROUPS if reference else ALL_GROUPS
    groups = known_groups if only is None else tuple(name.strip() for name in only.split(",") if name.strip())
    for name in groups:
        require_known("--only", name, known_groups)
    if not groups:
        raise ConfigError("--only names nothing", f"of {', '.join(known_groups)}, with commas")
    for file in (output, page_file):
        if file is not None:
            require_replaceable_file(file, force=force)
    with steps_bar(f"calibrating{compiling()}"):
        dives, failed = _read(logs, resolved, verbose, allow_damaged=allow_damaged, one_dive=one_dive)
        if not dives:
            return failed
        kept, held = _parted(dives, hold_out)
        known, ways = Geometry.of(resolved.dvl), len(possible_axes(kept[0].dive.dvl))
        if mounting == "unknown":
            resolved = with_mounting(resolved, likeliest_mounting(kept))
            kept, held = ([dive.with_config(resolved) for dive in some] for some in (kept, held))
        asked = [dive.innovations() for dive in kept]
        found = calibrated(asked, resolved, groups, one_delay=delays == "one")
        found = with_reference(found, kept, asked, groups) if reference else found
        found = found.from_mounting(known, ways) if mounting == "unknown" else found
        noise = found.noise if found.proposes_noise else None
        others = [held_out_row(dive, found.change, noise) for dive in track_progress("trying it on other dives", held)]
        found = replace(found, held_out=tuple(others))
    for read, prepared in zip(kept, (dive.prepared for dive in asked), strict=True):
        notes = (*read.dive.notes, *prepared.notes)
        log_notes([replace(note, text=f"{read.dive.name}: {note.text}") for note in notes], verbose=verbose > 0)
    settings_file = "" if output is None else str(output)
    write_stdout(written(calibration_result(found, resolved, settings_file), format_))
    # Both files, or, if the work is interrupted, none.
    is_found = bool(found.estimated) or found.proposes_noise
    contents: dict[Path, str] = {}
    if page_file is not None:
        figures = calibration_figures(found, asked)
        contents[page_file] = render(calibration_result(found, resolved, settings_file, figures), "html")
    if output is not None and is_found:
        contents[output] = calibration_toml(found, [dive.prepared.alignment.start_ns for dive in asked])
    with ExitStack() as stack:
        for file, content in contents.items():
            stack.enter_context(result_file(file, force=force)).write_text(content, "utf-8")
    for file in contents:
        log_to_stderr(f"wrote {file}")
    if not is_found:
        raise LogError(
            "nothing could be estimated from these dives",
            "record turns at speed, changes of speed, rolling and pitching, and calibrate by those",
        )
    return failed


def _read(
    logs: list[str], config: "Config", verbose: int, *, allow_damaged: bool, one_dive: bool
) -> tuple[list["ReadDive"], int]:
    """Read the dives; one that cannot be used does not stop the others."""
    from insdvl_replay.batch.dive_paths import find_dives
    from insdvl_replay.calibration.innovations import read_dive
    from insdvl_replay.cli.messages import log_failure
    from insdvl_replay.core.runtime import track_progress

    paths, dives, code = find_dives(logs), [], 0
    for path in track_progress("reading", [paths] if one_dive else [[path] for path in paths]):
        try:
            read = read_dive(path, config, allow_damaged=allow_damaged)
            read.innovations()
            dives.append(read)
        except Exception as error:
            code = max(code, log_failure(error, verbose))
    return dives, code


def _parted(dives: list["ReadDive"], hold_out: list[str]) -> tuple[list["ReadDive"], list["ReadDive"]]:
    """Set dives aside to try the result on: every so many of them, or those that are named."""
    from insdvl_replay.core.errors import ConfigError, require_known

    names = [read.dive.name for read in dives]
    aside: set[int] = set()
    for wanted in hold_out:
        try:
            share = float(wanted)
        except ValueError:
            require_known("--hold-out", wanted, names)
            aside.update(row for row, name in enumerate(names) if name == wanted)
            continue
        if not 0.0 < share < 1.0:
            raise ConfigError(f"--hold-out {wanted}: a share lies between 0 and 1", "for example --hold-out 0.3")
        count = max(1, round(share * len(names)))
        aside.update(len(names) - 1 - round(i * len(names) / count) for i in range(count))
    if len(aside) == len(names):
        raise ConfigError("--hold-out leaves no dive to fit", "name more dives, or hold out fewer")
    return (
        [read for row, read in enumerate(dives) if row not in aside],
        [read for row, read in enumerate(dives) if row in aside],
    )
