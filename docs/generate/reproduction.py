"""The parts of docs/reproduction.md that the program writes: every table, figure and claim of the paper beside ours.

    python docs/generate/reproduction.py [FOLDER]

FOLDER holds the eight dives of the AUV Snapir, which are not published. Without them, the parts of the page that need
them stay as they are, and all others are written. A test holds the page equal to what this writes.
"""

import math
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import claims
import courses
import pandas as pd
import paper_tables
import pictures
from paper_tables import Compared, percent
from written import PROJECT, markdown_table, renewed

from insdvl_replay.core.config import Config
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.quantities import label
from insdvl_replay.core.states import NINE
from insdvl_replay.core.tables import PooledRow, finite
from insdvl_replay.document.parts import Result
from insdvl_replay.evaluation.answers import pooled_evidence
from insdvl_replay.evaluation.ensemble import Ensemble
from insdvl_replay.preparation.prepared import read_checked_dive
from insdvl_replay.preparation.replay import Replay, replay_dive, replay_log
from insdvl_replay.studies.montecarlo import study_montecarlo
from insdvl_replay.studies.observability import study_observability
from insdvl_replay.studies.window import study_window

PAGE = PROJECT / "docs" / "reproduction.md"
SNAPIR = PROJECT / "examples" / "snapir.toml"
PAPER_NOISE = SNAPIR.with_name("paper_noise.toml")
DIVES = PROJECT.parent / "shared" / "data" / "snapir"
PUBLISHED_FILTER = (
    'filters.published={aiding=["velocity","acceleration"],'
    'acceleration={model="published",window=3,sd_mps2=0.103,max_window_gap_s=2.5}}'
)
MISPLACED = (
    "dvl.lever_arm_m=[-1.834,-0.034,0.095]",
    "reference.lever_arm_m=[0,0,0]",
    "dvl.mounting_rpy_deg=[-0.04,0,-0.16]",
    "dvl.scale=1.00135",
)
"""The arm from the reference's point to the DVL, taken for that from the IMU, and what was fitted with it."""
FOG_STUDIES = (
    *((scenario, "levy-klein") for scenario in ("straight", "figure-eight", "lawnmower")),
    ("lawnmower", "fog"),
)
FOG_RUNS = 50
TOGETHER = (
    "drift_30s", "velocity_along", "velocity_across", "level", "heading", "outage_30s", "outage_60s",
    "convergence_level",
)  # fmt: skip
"""Evidence that is shown of the eight dives together."""
DIVES_NEEDED = 8
GRADES = (("fog", "fibre-optic"), ("tactical", "tactical"), ("mems", "MEMS"))
"""IMUs from the best class to the worst, each with the preset of its name."""
GRADE_SCENARIO = "figure-eight"


@dataclass(frozen=True)
class AtSea:
    """What the eight dives give."""

    window: Result
    dives: list[Replay]  # with the paper's noise
    fitted: list[Replay]  # with fitted noise
    misplaced: list[Replay]  # with a wrong lever arm


@dataclass(frozen=True)
class Findings:
    """All that the page draws on."""

    straight: Replay
    eight: Replay
    ensembles: tuple[Ensemble, ...]
    montecarlo: Result
    fog: dict[tuple[str, str], Result]
    grades: dict[str, Result]  # by grade of the IMU
    observability: Result
    eights: list[courses.Eight]  # other courses than that of the sample log
    sea: AtSea | None  # None without the dives


def find(folder: Path) -> Findings:
    """Repeat everything that can be repeated."""
    config = load_config("levy-klein")
    with_published = load_config("levy-klein", overrides=[PUBLISHED_FILTER])
    montecarlo, ensembles = study_montecarlo("lawnmower", config)
    return Findings(
        straight=sample("straight", with_published),
        eight=sample("figure_eight", with_published),
        ensembles=ensembles,
        montecarlo=montecarlo,
        fog={(where, preset): fog_study(where, preset) for where, preset in FOG_STUDIES},
        grades={grade: grade_study(grade) for grade, _ in GRADES},
        observability=study_observability("straight", config, earth_rate=False),
        eights=courses.replayed(),
        sea=find_at_sea(folder),
    )


def find_at_sea(folder: Path) -> AtSea | None:
    """Replay the eight dives; None where they are not all there."""
    paths = sorted(folder.glob("*.mcap"))
    if len(paths) != DIVES_NEEDED:
        return None
    fitted = load_config(file=SNAPIR)
    snapir = load_config(file=[SNAPIR, PAPER_NOISE])
    misplaced = load_config(file=[SNAPIR, PAPER_NOISE], overrides=MISPLACED)
    return AtSea(
        window=study_window(paths, snapir),
        dives=[replay_log(path, snapir) for path in paths],
        fitted=[replay_log(path, fitted) for path in paths],
        misplaced=[replay_log(path, misplaced) for path in paths],
    )


def grade_study(grade: str) -> Result:
    """Simulate dives with an IMU of a grade, and its preset."""
    return study_montecarlo(GRADE_SCENARIO, load_config(preset=grade), imu=grade, runs=FOG_RUNS)[0]


def fog_study(scenario: str, preset: str) -> Result:
    """Simulate dives with the sensors of a survey vehicle."""
    return study_montecarlo(scenario, load_config(preset=preset), imu="fog", runs=FOG_RUNS)[0]


def sample(name: str, config: Config) -> Replay:
    """Replay a sample log, and keep all of P."""
    return replay_dive(
        read_checked_dive(PROJECT / "sample_logs" / f"{name}.mcap", config), config, keep_cov=True
    )


def written(found: Findings) -> str:
    """docs/reproduction.md as it should be; what needs the eight dives stays as it is without them."""
    straight = paper_tables.compared("straight", found.straight)
    eight = paper_tables.compared("figure_eight", found.eight)
    parts: dict[str, Callable[[], str]] = {
        "limits": limits,
        "headline": partial(paper_tables.headline, straight, eight),
        "tally": partial(paper_tables.tally, straight, eight),
        "sigmas": partial(paper_tables.sigmas, straight),
        "times": partial(paper_tables.times, straight),
        "eight_sigmas": partial(paper_tables.sigmas, eight),
        "eight_times": partial(paper_tables.times, eight),
        "courses": partial(courses.ranges, found.eights),
        "contradictions": partial(paper_tables.contradictions, straight, eight),
        "claims": partial(claims_in_words, found, straight, eight),
        "grades": partial(grades, found),
        "tuning": partial(tuning, found),
        "verdicts": partial(verdicts, [found.straight, found.eight]),
    }
    if found.sea is not None:
        parts |= {
            "claims_at_sea": partial(claims_at_sea, found.sea),
            "verdicts_at_sea": partial(verdicts, found.sea.dives),
            "together": partial(together, found.sea),
            "noise": partial(noise, found.sea),
            "positions": partial(positions, found.sea),
            "geometry": partial(geometry, found.sea),
        }
    return renewed(PAGE.read_text("utf-8"), parts, "make reproduce")


def limits() -> str:
    """Say what counts as agreement."""
    return (
        f"The tables say *yes* or *repeated* within these limits, and a number beyond them is bold:\n\n"
        f"- a sigma within {100 * paper_tables.SD_WITHIN:.0f} %, its improvement within "
        f"{paper_tables.IMPROVEMENT_WITHIN_PCT:.0f} points\n"
        f"- a time within {paper_tables.REACHED_WITHIN_S:.0f} s, a mean within "
        f"{paper_tables.MEAN_WITHIN_PCT:.0f} points\n"
        f"- a claim in words by its rule in [claims.py](generate/claims.py)"
    )


def claims_in_words(found: Findings, straight: Compared, eight: Compared) -> str:
    """What the paper says in words and simulations show, in its order."""
    table = [
        *claims.observability_claims(found.observability),
        *claims.lawnmower_claims(found.ensembles, found.montecarlo),
        *claims.straight_claims(found.straight),
        *claims.eight_claims(found.eight, found.straight),
        *claims.conclusion_claims(straight.improvement, eight.improvement, found.grades),
    ]
    return claims_table(table)


def claims_at_sea(sea: AtSea) -> str:
    """What the paper says in words and needs dives."""
    return claims_table([*claims.window_claims(sea.window), *claims.sea_claims(sea.dives)])


def claims_table(found: Iterable[claims.Claim]) -> str:
    """Write claims with their verdicts."""
    rows = [(claim.place, claim.says, claim.found, claim.verdict) for claim in found]
    return markdown_table(("where", "the paper says", "here", ""), rows)


def grades(found: Findings) -> str:
    """What accelerations give with IMUs of three classes, and whether they stand for a better IMU."""
    rows = []
    better: Result | None = None
    for grade, words in GRADES:
        study = found.grades[grade]
        predicted, true = _improvements(study.tables["montecarlo"])
        against = "-" if better is None else f"{claims.error_over_better(study, better):.1f}"
        rows.append((words, grade, predicted, true, against, *_nees(study.tables["verdicts"])))
        better = study
    titles = (
        "IMU", "settings", "predicted", "true", "aided error over that of the better IMU without accelerations",
        "NEES: baseline", "with accelerations",
    )  # fmt: skip
    return markdown_table(titles, rows)


def verdicts(replays: list[Replay]) -> str:
    """What the paper does not ask: whether the same improvements are real. Without a verdict: noise is far off."""
    return markdown_table(
        (
            "dive",
            "filter",
            "predicted",
            "position rms [m]: baseline",
            "with accelerations",
            "innovations",
        ),
        [row for replay in replays for row in _verdicts(replay)],
    )


def _verdicts(replay: Replay) -> Iterator[tuple[str, ...]]:
    errors = claims.position_errors([replay]).iloc[0]
    for name, verdict in replay.verdicts.items():
        yield (
            replay.dive.name,
            name,
            percent(verdict.mean_improvement_pct),
            f"{errors['baseline']:.2f}",
            f"{errors[name]:.2f}",
            verdict.consistency,
        )


def together(sea: AtSea) -> str:
    """What the eight dives say together, from their own starts and while the DVL is withheld."""
    rows = []
    for name in ("windowed", "published"):
        evidence = [
            [row for row in replay.tables.evidence if row.filter == name] for replay in sea.dives
        ]
        pooled = {row.quantity: row for row in pooled_evidence(name, evidence)}
        rows += [_of_eight(name, pooled[quantity]) for quantity in TOGETHER]
    return markdown_table(
        ("filter", "quantity", "candidate over baseline, 95 %", "smaller on", "p", "verdict"), rows
    )


def noise(sea: AtSea) -> str:
    """The eight dives with the paper's noise, and with the noise that they show."""
    rows = []
    for noise, dives in (("the paper's", sea.dives), ("fitted", sea.fitted)):
        for name in ("windowed", "published"):
            evidence = [
                [row for row in replay.tables.evidence if row.filter == name] for replay in dives
            ]
            pooled = {row.quantity: row for row in pooled_evidence(name, evidence)}
            outages = (
                _of_eight(name, pooled[quantity])[2] for quantity in ("outage_30s", "outage_60s")
            )
            median_m = claims.position_errors(dives).median()
            rms = f"{median_m['baseline']:.2f}", f"{median_m[name]:.2f}"
            nis = f"{claims.mean_nis(dives).median() / 3.0:.2g}"
            rows.append((noise, nis, name, *rms, *outages, _larger(dives, name)))
    titles = (
        "noise",
        "NIS / dof of the baseline",
        "filter",
        "position rms [m]: baseline",
        "with accelerations",
    )
    return markdown_table(
        (*titles, "drift without DVL, 30 s: over the baseline's", "60 s", "larger on"), rows
    )


def _of_eight(name: str, row: PooledRow) -> tuple[str, ...]:
    ratio = f"{finite(row.ratio):.3g}"
    p = "-"
    if math.isfinite(finite(row.p)):
        ratio += f" [{finite(row.low):.3g}, {finite(row.high):.3g}]"
        p = f"{finite(row.p):.2g}"
    return name, label(row.quantity), ratio, f"{row.dives_won} of {row.dives}", p, row.verdict


def tuning(found: Findings) -> str:
    """How settings and sensors decide whether a believed improvement is a true one."""
    studies = {("lawnmower", "levy-klein", "as the filter expects"): found.montecarlo}
    studies |= {(*key, "fibre-optic"): study for key, study in found.fog.items()}
    return markdown_table(
        (
            "scenario",
            "sensors",
            "settings",
            "predicted",
            "true",
            "NEES: baseline",
            "with accelerations",
        ),
        [
            (
                scenario,
                sensors,
                preset,
                *_improvements(study.tables["montecarlo"]),
                *_nees(study.tables["verdicts"]),
            )
            for (scenario, preset, sensors), study in studies.items()
        ],
    )


def _improvements(table: pd.DataFrame) -> tuple[str, ...]:
    rows = table[(table["filter"] == "aided") & table["state"].isin([state.id for state in NINE])]
    return tuple(percent(rows[f"{kind}_improvement_pct"].mean()) for kind in ("predicted", "true"))


def _nees(table: pd.DataFrame) -> tuple[str, ...]:
    return tuple(f"{row.mean_nees:.1f}, {row.verdict}" for row in table.itertuples())


def positions(sea: AtSea) -> str:
    """The eight dives together."""
    errors = claims.position_errors(sea.dives).median()
    return markdown_table(
        ("median of the eight dives", *errors.index),
        [("position rms [m]", *(f"{error:.2f}" for error in errors))],
    )


def geometry(sea: AtSea) -> str:
    """The eight dives with the DVL where it is, and where it was once taken to be."""
    return markdown_table(
        (
            "arm from the IMU to the DVL",
            "mean NIS of the baseline, median",
            "windowed: larger on",
            "published: larger on",
        ),
        [
            (
                arm,
                f"{claims.mean_nis(dives).median():.4f}",
                *(_larger(dives, name) for name in ("windowed", "published")),
            )
            for arm, dives in (
                ("0.22 m, by the innovations", sea.dives),
                ("1.84 m, from the reference's point", sea.misplaced),
            )
        ],
    )


def _larger(dives: list[Replay], name: str) -> str:
    """Write on how many dives the drift in 60 s without the DVL is larger."""
    rows = [row for replay in dives for row in replay.tables.evidence]
    ratios = [
        finite(row.ratio) for row in rows if (row.filter, row.quantity) == (name, "outage_60s")
    ]
    return f"{sum(ratio > 1.0 for ratio in ratios)} of {len(ratios)}"


def drawn(found: Findings) -> dict[str, Callable[[], bytes]]:
    """Name the pictures that belong to the page and to no sample; that of the window needs the eight dives."""
    aided = claims.named(found.ensembles, "aided")
    named = pictures.ensemble_pictures(aided, f"aided: {found.montecarlo.title}")
    sample = paper_tables.compared("figure_eight", found.eight)
    named["docs/courses.svg"] = partial(courses.picture, found.eights, sample)
    return named if found.sea is None else named | pictures.window_picture(found.sea.window)


if __name__ == "__main__":
    given = Path(sys.argv[1]) if len(sys.argv) > 1 else DIVES
    all_found = find(given)
    if all_found.sea is None:
        sys.stderr.write(
            f"{given}: has not the eight dives, so the parts that need them stay as they are\n"
        )
    PAGE.write_text(written(all_found), "utf-8")
    pictures.write(drawn(all_found))
