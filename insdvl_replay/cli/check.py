"""``insdvl-replay check``. What is heavy to import waits until there is work to do."""

from contextlib import closing
from pathlib import Path
from typing import Annotated

import typer

from insdvl_replay.cli import options as opt
from insdvl_replay.core.errors import ConfigError, error_context, looked_for

GATE_FAILED = 1


def check(
    gates: Annotated[Path, typer.Argument(metavar="GATES", help="What must hold, a TOML file.")],
    dives: Annotated[
        list[str],
        typer.Argument(
            metavar="[DIVE]...", help="Logs, bags, result folders, patterns, .txt lists; left out: those in GATES."
        ),
    ] = [],  # noqa: B006
    update: Annotated[bool, typer.Option("--update", help="Show what moved, then make it the baseline.")] = False,
    results: Annotated[
        Path, typer.Option("--results", metavar="DIR", help="Where each replayed dive gets a folder of its name.")
    ] = Path("checked"),
    config: Annotated[
        list[Path],
        typer.Option(
            "-c", "--config", metavar="FILE", help="Settings in place of those named in GATES. May be repeated."
        ),
    ] = [],  # noqa: B006
    preset: opt.Preset = None,
    settings: opt.Settings = [],  # noqa: B006
    allow_damaged: opt.AllowDamaged = False,
    allow_code: opt.AllowCode = False,
    format_: Annotated[opt.CheckFormat, typer.Option("--format", help="How it is told.")] = opt.CheckFormat.TEXT,
    output: Annotated[
        Path | None, typer.Option("--output", metavar="FILE", help="Write it here, and text to stdout.")
    ] = None,
    summary: Annotated[
        Path | None, typer.Option("--summary-file", metavar="FILE", help="Add it here, too, as Markdown.")
    ] = None,
    only: Annotated[
        list[str], typer.Option("--only", metavar="GATE", help="Gates of this name or pattern alone. May be repeated.")
    ] = [],  # noqa: B006
    skip: Annotated[
        list[str], typer.Option("--skip", metavar="GATE", help="No gates of this name or pattern. May be repeated.")
    ] = [],  # noqa: B006
    shard: Annotated[
        str, typer.Option("--shard", metavar="I/N", help="Every N-th dive from the I-th: a part of the archive.")
    ] = "1/1",
    histories: Annotated[
        bool, typer.Option("--keep-histories", help="Write replay.mcap, the largest file of a result, too.")
    ] = False,
    jobs: opt.Jobs = 1,
    scheduler: opt.Scheduler = None,
    rerun: opt.Rerun = False,
    verbose: opt.Verbose = 0,
    quiet: opt.Quiet = False,
) -> int:
    """Hold dives against gates, for a job that runs every night.

    Logs are replayed first, but for those whose log, settings, versions and code are those of the result that lies
    there; result folders are taken as they are. All gates of all dives are judged. What is missing or empty never
    passes. The exit code is 0 if no gate of level error failed, 1 if one did, 3 if a dive cannot be used.

    \b
    Example:
      insdvl-replay check gates.toml
      insdvl-replay check gates.toml --jobs 4 --format junit --output gates.xml
      insdvl-replay check gates.toml replay/dive
      insdvl-replay check gates.toml --only "position*" --shard 1/4
    """
    from insdvl_replay.batch.dive_paths import find_dives
    from insdvl_replay.batch.jobs import ReplayOptions, plan_jobs
    from insdvl_replay.changes import formats as written
    from insdvl_replay.changes.gates import (
        Checked,
        checked_replay,
        checked_results,
        chosen_gates,
        compare_with_baselines,
        evaluate_gates,
        load_gates,
        require_known_names,
        write_baselines,
    )
    from insdvl_replay.cli.messages import log_failure, log_to_stderr, write_stdout
    from insdvl_replay.cli.run import outcomes
    from insdvl_replay.core.config_file import load_config
    from insdvl_replay.core.words import GateStatus
    from insdvl_replay.results.folder import COMPLETE, require_replaceable_file, result_file

    # What is asked for
    part, slash, parts = shard.partition("/")
    if not (slash and part.isdecimal() and parts.isdecimal() and 1 <= int(part) <= int(parts)):
        raise ConfigError(f"--shard {shard}: is not a part such as 1/4", "--shard 1/4, --shard 2/4 and so on")
    chosen = chosen_gates(load_gates(gates), only, skip)
    content = chosen.content
    if not (dives or content.dives):
        raise ConfigError(f"{gates}: names no dives", f'`insdvl-replay check {gates} DIVE...`, or dives = ["*.mcap"]')
    names, beside = (dives, Path()) if dives else (content.dives, gates.parent)
    paths = find_dives(names, beside, results=True)[int(part) - 1 :: int(parts)]
    for option, file in (("--output", output), ("--summary-file", summary)):
        if file is not None:
            with error_context(option):
                require_replaceable_file(file, force=True)
                if file.resolve() in {read.resolve() for read in (gates, *paths)}:
                    raise ConfigError(f"{file}: is what is checked", "give it another name")
    if not config and content.config is not None:
        named = gates.parent / content.config
        with looked_for(named):
            if not named.is_file():
                found = f"{gates}: config names {named}, which is no file"
                raise ConfigError(found, "paths are seen from the gate file")
        config = [named]
    options = ReplayOptions(
        load_config(preset or content.preset, config, settings, allow_code=allow_code),
        allow_damaged=allow_damaged or content.allow_damaged,
        histories=histories,
    )
    logs = [path for path in paths if path.suffix != ".json" and not (path / COMPLETE).is_file()]
    require_known_names(chosen, list(options.config.filters) if len(logs) == len(paths) else None)

    # Replays, stored results, and what the gates say of them
    checked: list[Checked] = []
    with closing(outcomes(plan_jobs(logs, results, options), jobs, scheduler, force=True, rerun=rerun)) as replays:
        for path in paths:
            if path in logs:
                outcome = next(replays)
                checked.append(checked_replay(outcome.job.target, outcome.result))
            else:
                checked += checked_results(path)
    codes = [log_failure(result, verbose) for _, result, _ in checked if isinstance(result, Exception)]
    if update:
        if all(gate.baseline is None for gate in content.gate):
            raise ConfigError(f"{gates}: no gate has a baseline", 'baseline = "baselines/{log}.json"')
        write_stdout(written.baseline_text(compare_with_baselines(chosen, checked)))
        for baseline in write_baselines(chosen, checked):
            log_to_stderr(f"wrote {baseline}")
    result = evaluate_gates(chosen, checked)

    # Output
    formats = {
        opt.CheckFormat.TEXT: written.check_text,
        opt.CheckFormat.MARKDOWN: written.check_markdown,
        opt.CheckFormat.JSON: written.check_json,
        opt.CheckFormat.JUNIT: written.junit_xml,
        opt.CheckFormat.GITHUB: written.github_annotations,
    }
    sentence = written.check_sentence(result)
    text = f"{sentence}\n" if quiet and format_ is opt.CheckFormat.TEXT else formats[format_](result)
    if output is None:
        write_stdout(text, commands=format_ is opt.CheckFormat.GITHUB)
    else:
        with result_file(output, force=True) as file:
            file.write_text(text, "utf-8")
        write_stdout(written.check_text(result))
    if summary is not None:
        try:
            with summary.open("a", encoding="utf-8") as stream:  # other steps of a job write to it, too
                stream.write(written.check_markdown(result))
        except OSError as error:
            hint = "check the path of --summary-file"
            raise ConfigError(f"{summary}: cannot be written: {error.strerror}", hint) from error
    codes += [GATE_FAILED] * result.count(GateStatus.FAILED)
    if codes:
        first = result.judgements[0]
        log_to_stderr(f"error: {sentence}; the first: {first.dive}: {first.gate}: {'; '.join(first.reasons)}")
    return max(codes, default=0)
