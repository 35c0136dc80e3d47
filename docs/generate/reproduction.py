"""The parts of docs/reproduction.md that the program writes: every table, figure and claim of the paper beside ours.

    python docs/generate/reproduction.py [FOLDER]

FOLDER holds the eight dives of the AUV Snapir. A test holds the page equal to what this writes.
"""

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import claims
import numpy as np
import pandas as pd
import pictures
from written import PROJECT, markdown_table, renewed

from insdvl_replay.core.config import Config
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.quantities import label
from insdvl_replay.core.result import Result
from insdvl_replay.core.states import NINE
from insdvl_replay.core.tables import PooledRow, finite
from insdvl_replay.evaluation.answers import pooled_evidence
from insdvl_replay.evaluation.ensemble import Ensemble
from insdvl_replay.preparation.prepared import read_checked_dive
from insdvl_replay.replay import Replay, replay_dive, replay_log
from insdvl_replay.studies.montecarlo import study_montecarlo
from insdvl_replay.studies.observability import study_observability
from insdvl_replay.studies.window import study_window

PAGE = PROJECT / "docs" / "reproduction.md"
PUBLISHED = PROJECT / "docs" / "generate" / "levy_klein_straight.csv"
"""Levy and Klein, both tables of the straight line."""
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
SD_WITHIN = 0.05
"""Standard deviations agree within this share."""
REACHED_WITHIN_S = 8.0
"""Convergence times agree within this."""
MEAN_WITHIN_PCT = 3.0
"""Mean improvements agree within this many percent."""


@dataclass(frozen=True)
class Findings:
    """All that the page draws on."""

    straight: Replay
    eight: Replay
    ensembles: tuple[Ensemble, ...]
    montecarlo: Result
    fog: dict[tuple[str, str], Result]
    window: Result
    observability: Result
    dives: list[Replay]
    fitted: list[Replay]
    misplaced: list[Replay]


def find(dives: Path) -> Findings:
    """Repeat everything."""
    config, fitted, snapir = load_config(), load_config(file=SNAPIR), load_config(file=[SNAPIR, PAPER_NOISE])
    misplaced = load_config(file=[SNAPIR, PAPER_NOISE], overrides=MISPLACED)
    with_published = load_config(overrides=[PUBLISHED_FILTER])
    montecarlo, ensembles = study_montecarlo("lawnmower", config)
    paths = sorted(dives.glob("*.mcap"))
    return Findings(
        straight=sample("straight", with_published),
        eight=sample("figure_eight", with_published),
        ensembles=ensembles,
        montecarlo=montecarlo,
        fog={(where, preset): fog_study(where, preset) for where, preset in FOG_STUDIES},
        window=study_window(paths, snapir),
        observability=study_observability("straight", config, earth_rate=False),
        dives=[replay_log(path, snapir) for path in paths],
        fitted=[replay_log(path, fitted) for path in paths],
        misplaced=[replay_log(path, misplaced) for path in paths],
    )


def fog_study(scenario: str, preset: str) -> Result:
    """Simulate dives with the sensors of a survey vehicle."""
    return study_montecarlo(scenario, load_config(preset=preset), imu="fog", runs=FOG_RUNS)[0]


def sample(name: str, config: Config) -> Replay:
    """Replay a sample log, and keep all of P."""
    return replay_dive(read_checked_dive(PROJECT / "sample_logs" / f"{name}.mcap", config), config, keep_cov=True)


def written(found: Findings) -> str:
    """docs/reproduction.md as it should be."""
    parts: dict[str, Callable[[], str]] = {
        name: partial(part, found)
        for name, part in {
            "limits": limits,
            "sigmas": sigmas,
            "times": times,
            "eight": eight,
            "claims": claims_in_words,
            "tuning": tuning,
            "verdicts": verdicts,
            "together": together,
            "noise": noise,
            "positions": positions,
            "geometry": geometry,
        }.items()
    }
    return renewed(PAGE.read_text("utf-8"), parts, "make reproduce")


def limits(_: Findings) -> str:
    """Say what counts as agreement."""
    return (
        f"The tables say *yes* or *repeated* within these limits:\n\n"
        f"- a sigma within {100 * SD_WITHIN:.0f} %, a time within {REACHED_WITHIN_S:.0f} s, a mean within "
        f"{MEAN_WITHIN_PCT:.0f} %\n- a claim in words by its rule in [claims.py](generate/claims.py)"
    )


def sigmas(found: Findings) -> str:
    """The straight line's sigmas at the end."""
    published = pd.read_csv(PUBLISHED).set_index("state")
    ours = claims.by_state(claims.frame(found.straight.tables.improvement), "aided")
    there = published["improvement_pct"].fillna(0.0).mean()
    here = claims.mean_over(found.straight, "improvement")
    return markdown_table(
        ("state", "unit", "baseline: paper", "here", "", "aided: paper", "here", "", "improvement: paper", "here"),
        [
            *(_sigmas(row, ours.loc[state]) for state, row in published.iterrows()),
            ("**mean**", *[""] * 7, percent(there), percent(here)),
        ],
    )


def _sigmas(published: pd.Series, ours: pd.Series) -> tuple[str, ...]:
    return (
        str(published.name),
        str(published["unit"]),
        f"{published['baseline_sd']:.2f}",
        f"{ours['baseline_sd']:.2f}",
        deviation(ours["baseline_sd"], published["baseline_sd"]),
        f"{published['aided_sd']:.2f}",
        f"{ours['sd']:.2f}",
        deviation(ours["sd"], published["aided_sd"]),
        percent(published["improvement_pct"]),
        percent(ours["improvement_pct"]),
    )


def times(found: Findings) -> str:
    """The straight line's times of the nearest approach to the baseline's final sigma, and of the crossing."""
    published = pd.read_csv(PUBLISHED).set_index("state")
    ours = claims.by_state(claims.frame(found.straight.tables.convergence), "aided")
    there = published["convergence_improvement_pct"].fillna(0.0).mean()
    nearest, crossing = nearest_pct(found.straight), claims.mean_over(found.straight, "convergence")
    return markdown_table(
        ("state", "paper [s]", "nearest approach [s]", "agrees", "sooner: paper", "here", "crossing [s]", "sooner"),
        [
            *(_times(row, ours.loc[state]) for state, row in published.iterrows()),
            ("**mean**", "", "", agrees(there, nearest), percent(there), percent(nearest), "", percent(crossing)),
        ],
    )


def nearest_pct(replay: Replay) -> float:
    """The mean convergence of the aided filter by the nearest approach, as the paper computes it."""
    return finite(replay.verdicts["aided"].mean_nearest_approach_improvement_pct)


def _times(published: pd.Series, ours: pd.Series) -> tuple[str, ...]:
    there, nearest_s = published["reached_s"], ours["nearest_approach_s"]
    # The paper prints no time where its improvement is none: the end.
    expected_s = ours["baseline_s"] if np.isnan(there) else there
    return (
        str(published.name),
        "-" if np.isnan(there) else f"{there:.0f}",
        f"{nearest_s:.0f}",
        "yes" if abs(nearest_s - expected_s) <= REACHED_WITHIN_S else "**no**",
        percent(published["convergence_improvement_pct"]),
        percent(ours["nearest_approach_improvement_pct"]),
        f"{ours['reached_s']:.0f}" if ours["status"] == "reached" else str(ours["status"]).replace("_", " "),
        percent(ours["improvement_pct"]),
    )


def eight(found: Findings) -> str:
    """The figure-eight's means."""
    improvement, crossing = (claims.mean_over(found.eight, table) for table in ("improvement", "convergence"))
    rows = {
        "mean improvement": (40.0, improvement),
        "mean convergence, nearest approach": (54.0, nearest_pct(found.eight)),
        "mean convergence, crossing": (np.nan, crossing),
    }
    return markdown_table(
        ("", "paper", "here", "agrees"),
        [
            (name, percent(there), percent(here), "" if np.isnan(there) else agrees(there, here))
            for name, (there, here) in rows.items()
        ],
    )


def claims_in_words(found: Findings) -> str:
    """What the paper says in words, in its order."""
    return markdown_table(
        ("where", "the paper says", "here", ""),
        [(claim.place, claim.says, claim.found, claim.verdict) for claim in _claims(found)],
    )


def _claims(found: Findings) -> Iterator[claims.Claim]:
    yield from claims.observability_claims(found.observability)
    yield from claims.window_claims(found.window)
    yield from claims.lawnmower_claims(found.ensembles, found.montecarlo)
    yield from claims.straight_claims(found.straight)
    yield from claims.eight_claims(found.eight, found.straight)
    yield from claims.sea_claims(found.dives)


def verdicts(found: Findings) -> str:
    """What the paper does not ask: whether the same improvements are real."""
    replays = [found.straight, found.eight, *found.dives]
    return markdown_table(
        (
            "dive",
            "filter",
            "predicted",
            "position rms [m]: baseline",
            "with accelerations",
            "measured",
            "prediction",
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
            verdict.verdict,
            verdict.prediction,
            verdict.consistency,
        )


def together(found: Findings) -> str:
    """What the eight dives say together, measured from random starts and while the DVL is withheld."""
    rows = []
    for name in ("windowed", "published"):
        evidence = [[row for row in replay.tables.evidence if row.filter == name] for replay in found.dives]
        pooled = {row.quantity: row for row in pooled_evidence(name, evidence)}
        rows += [_of_eight(name, pooled[quantity]) for quantity in TOGETHER]
    return markdown_table(("filter", "quantity", "candidate over baseline, 95 %", "smaller on", "p", "verdict"), rows)


def noise(found: Findings) -> str:
    """The eight dives with the paper's noise, and with the noise that they show."""
    rows = []
    for noise, dives in (("the paper's", found.dives), ("fitted", found.fitted)):
        for name in ("windowed", "published"):
            evidence = [[row for row in replay.tables.evidence if row.filter == name] for replay in dives]
            pooled = {row.quantity: row for row in pooled_evidence(name, evidence)}
            outages = (_of_eight(name, pooled[quantity])[2] for quantity in ("outage_30s", "outage_60s"))
            median_m = claims.position_errors(dives).median()
            rms = f"{median_m['baseline']:.2f}", f"{median_m[name]:.2f}"
            nis = f"{claims.mean_nis(dives).median() / 3.0:.2g}"
            rows.append((noise, nis, name, *rms, *outages, _worse(dives, name)))
    titles = "noise", "NIS / dof of the baseline", "filter", "position rms [m]: baseline", "with accelerations"
    return markdown_table((*titles, "drift without DVL, 30 s: over the baseline's", "60 s", "worse on"), rows)


def _of_eight(name: str, row: PooledRow) -> tuple[str, ...]:
    numbers = row.ratio, row.low, row.high
    ratio = "{:.3g} [{:.3g}, {:.3g}]".format(*(finite(number) for number in numbers))
    return name, label(row.quantity), ratio, f"{row.dives_won} of {row.dives}", f"{finite(row.p):.2g}", row.verdict


def tuning(found: Findings) -> str:
    """How settings and sensors decide whether a believed improvement is a true one."""
    studies = {("lawnmower", "levy-klein", "as the filter expects"): found.montecarlo}
    studies |= {(*key, "fibre-optic"): study for key, study in found.fog.items()}
    return markdown_table(
        ("scenario", "sensors", "settings", "predicted", "true", "NEES: baseline", "with accelerations"),
        [
            (scenario, sensors, preset, *_improvements(study.tables["montecarlo"]), *_nees(study.tables["verdicts"]))
            for (scenario, preset, sensors), study in studies.items()
        ],
    )


def _improvements(table: pd.DataFrame) -> tuple[str, ...]:
    rows = table[(table["filter"] == "aided") & table["state"].isin([state.id for state in NINE])]
    return tuple(percent(rows[f"{kind}_improvement_pct"].mean()) for kind in ("predicted", "true"))


def _nees(table: pd.DataFrame) -> tuple[str, ...]:
    return tuple(f"{row.mean_nees:.1f}, {row.verdict}" for row in table.itertuples())


def positions(found: Findings) -> str:
    """The eight dives together."""
    errors = claims.position_errors(found.dives).median()
    return markdown_table(
        ("median of the eight dives", *errors.index), [("position rms [m]", *(f"{error:.2f}" for error in errors))]
    )


def geometry(found: Findings) -> str:
    """The eight dives with the DVL where it is, and where it was once taken to be."""
    return markdown_table(
        ("arm from the IMU to the DVL", "mean NIS of the baseline, median", "windowed worse", "published worse"),
        [
            (
                arm,
                f"{claims.mean_nis(dives).median():.4f}",
                *(_worse(dives, name) for name in ("windowed", "published")),
            )
            for arm, dives in (
                ("0.22 m, by the innovations", found.dives),
                ("1.84 m, from the reference's point", found.misplaced),
            )
        ],
    )


def _worse(dives: list[Replay], name: str) -> str:
    verdicts = [replay.verdicts[name] for replay in dives if name in replay.verdicts]
    return f"{sum(verdict.verdict == 'worse' for verdict in verdicts)} of {len(verdicts)}"


def percent(value: float) -> str:
    """Write a percentage, or a dash."""
    return "-" if np.isnan(value) else f"{value:.1f} %"


def deviation(here: float, there: float) -> str:
    """Write how far ours is from the paper's, in bold where that is too far."""
    share = here / there - 1.0
    text = f"{100.0 * share:+.1f} %"
    return text if abs(share) <= SD_WITHIN else f"**{text}**"


def agrees(there: float, here: float) -> str:
    """Say whether two means agree."""
    return "yes" if abs(here - there) <= MEAN_WITHIN_PCT else "**no**"


def drawn(found: Findings) -> dict[str, Callable[[], bytes]]:
    """Name the pictures that belong to the page and to no sample."""
    aided = claims.named(found.ensembles, "aided")
    return pictures.study_pictures(aided, f"aided: {found.montecarlo.title}", found.window)


if __name__ == "__main__":
    all_found = find(Path(sys.argv[1]) if len(sys.argv) > 1 else DIVES)
    PAGE.write_text(written(all_found), "utf-8")
    pictures.write(drawn(all_found))
