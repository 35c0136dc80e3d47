"""Replay what has changed, hold all dives against the gates, and write the result in the form that is wanted."""

from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from insdvl_replay.batch.cluster import Cluster
from insdvl_replay.batch.dive_paths import find_dives
from insdvl_replay.batch.jobs import ReplayOptions, plan_jobs
from insdvl_replay.cli.dives import outcomes
from insdvl_replay.cli.messages import log_failure, log_to_stderr, write_stdout
from insdvl_replay.cli.options import CheckFormat
from insdvl_replay.core.config import Config
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.errors import ConfigError, error_context, looked_for
from insdvl_replay.core.words import GateStatus
from insdvl_replay.gates.checking import (
    Checked,
    checked_replay,
    checked_results,
    compare_with_baselines,
    evaluate_gates,
    write_baselines,
)
from insdvl_replay.gates.gate_file import Gates, chosen_gates, load_gates, require_known_names
from insdvl_replay.gates.model import CheckResult
from insdvl_replay.gates.output import (
    baseline_text,
    check_json,
    check_markdown,
    check_sentence,
    check_text,
    github_annotations,
    junit_xml,
)
from insdvl_replay.results.folder import COMPLETE, result_file
from insdvl_replay.results.workspace import replaceable_file

GATE_FAILED = 1

WRITTEN = {
    CheckFormat.TEXT: check_text,
    CheckFormat.MARKDOWN: check_markdown,
    CheckFormat.JSON: check_json,
    CheckFormat.JUNIT: junit_xml,
    CheckFormat.GITHUB: github_annotations,
}


@dataclass(frozen=True)
class OutputOptions:
    """How the result is written: to a file, with text to stdout, and, as Markdown, at the end of a summary."""

    format: CheckFormat
    file: Path | None
    summary: Path | None
    verbosity: int
    quiet: bool


@dataclass(frozen=True)
class GivenSettings:
    """Settings of the command line, which stand in place of those that the gate file names, or on top of them."""

    preset: str | None
    config: tuple[Path, ...]
    settings: tuple[str, ...]
    allow_code: bool


@dataclass(frozen=True)
class CheckOptions:
    """How dives are replayed, into folders below that of the results, before they are judged or become baselines."""

    results: Path
    jobs: int
    cluster: Cluster | None
    rerun: bool
    update: bool
    allow_damaged: bool
    histories: bool
    only: tuple[str, ...] = ()
    skip: tuple[str, ...] = ()
    shard: tuple[int, int] = (1, 1)


def check_dives(
    path: Path,
    dives: Sequence[str],
    given: GivenSettings,
    check: CheckOptions,
    output: OutputOptions,
) -> int:
    """Hold dives against gates."""
    gates = chosen_gates(load_gates(path), check.only, check.skip)
    chosen, beside = (dives, Path()) if dives else (gates.content.dives, path.parent)
    if not chosen:
        raise ConfigError(f"{path}: names no dives", f'`insdvl-replay check {path} DIVE...`, or dives = ["*.mcap"]')
    part, parts = check.shard
    paths = find_dives(chosen, beside, results=True)[part - 1 :: parts]
    _require_own_names(output, [path, *paths])
    damaged = check.allow_damaged or gates.content.allow_damaged
    options = ReplayOptions(_settings(gates, given), allow_damaged=damaged, histories=check.histories)
    require_known_names(gates, None if any(map(_is_result, paths)) else list(options.config.filters))
    checked = list(_checked(paths, options, check))
    codes = [log_failure(result, output.verbosity) for _, result, _ in checked if isinstance(result, Exception)]
    if check.update:
        _update(gates, checked)
    result = evaluate_gates(gates, checked)
    _report(result, output)
    codes += [GATE_FAILED] * result.count(GateStatus.FAILED)
    if codes:
        first = result.judgements[0]
        log_to_stderr(
            f"error: {check_sentence(result)}; the first: {first.dive}: {first.gate}: {'; '.join(first.reasons)}"
        )
    return max(codes, default=0)


def _require_own_names(output: OutputOptions, inputs: Sequence[Path]) -> None:
    """Refuse, before any work, to write where nothing can be written, or something is read."""
    for option, path in (("--output", output.file), ("--summary-file", output.summary)):
        if path is None:
            continue
        with error_context(option):
            replaceable_file(path)
            if path.resolve() in {read.resolve() for read in inputs}:
                raise ConfigError(f"{path}: is what is checked", "give it another name")


def _settings(gates: Gates, given: GivenSettings) -> Config:
    named, config = gates.content.config, given.config
    if not config and named is not None:
        file = gates.path.parent / named
        with looked_for(file):
            if not file.is_file():
                found = f"{gates.path}: config names {file}, which is no file"
                raise ConfigError(found, "paths are seen from the gate file")
        config = (file,)
    return load_config(given.preset or gates.content.preset, config, given.settings, allow_code=given.allow_code)


def _is_result(path: Path) -> bool:
    return path.suffix == ".json" or (path / COMPLETE).is_file()


def _checked(paths: Sequence[Path], options: ReplayOptions, check: CheckOptions) -> Iterator[Checked]:
    """Replay the logs among the dives, and read the results among them."""
    planned = plan_jobs([path for path in paths if not _is_result(path)], check.results, options)
    replays = outcomes(planned, check.jobs, check.cluster, force=True, rerun=check.rerun)
    with closing(replays):
        for path in paths:
            if _is_result(path):
                yield from checked_results(path)
            else:
                outcome = next(replays)
                yield checked_replay(outcome.job.target, outcome.result)


def _update(gates: Gates, checked: Sequence[Checked]) -> None:
    if all(gate.baseline is None for gate in gates.content.gate):
        raise ConfigError(f"{gates.path}: no gate has a baseline", 'baseline = "baselines/{log}.json"')
    write_stdout(baseline_text(compare_with_baselines(gates, checked)))
    for path in write_baselines(gates, checked):
        log_to_stderr(f"wrote {path}")


def _report(result: CheckResult, output: OutputOptions) -> None:
    if output.quiet and output.format is CheckFormat.TEXT:
        written = f"{check_sentence(result)}\n"
    else:
        written = WRITTEN[output.format](result)
    if output.file is None:
        write_stdout(written, commands=output.format is CheckFormat.GITHUB)
    else:
        with result_file(output.file, force=True) as file:
            file.write_text(written, "utf-8")
        write_stdout(check_text(result))
    if output.summary is not None:
        _append(output.summary, check_markdown(result))


def _append(path: Path, text: str) -> None:
    """Add to a file that other steps of a job write, too."""
    try:
        with path.open("a", encoding="utf-8") as file:
            file.write(text)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}", "check the path of --summary-file") from error
