"""What the paper says in words, each claim beside what the program finds.

Every claim is judged by a rule, so that the verdict next to it follows from the number.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import msgspec
import numpy as np
import pandas as pd
from msgspec import Struct

from insdvl_replay.core.dive_columns import seconds
from insdvl_replay.core.history import History
from insdvl_replay.core.states import NINE, STATES
from insdvl_replay.document.parts import Result
from insdvl_replay.evaluation.convergence import mean_over_nine
from insdvl_replay.evaluation.ensemble import Ensemble
from insdvl_replay.preparation.replay import Replay

REPEATED = "repeated"
SAME_PCT_SHOWN = 1.0
NOT_REPEATED = "**not repeated**"
INDEX = {state.id: state.index for state in STATES}
FACTOR = {state.id: state.factor for state in STATES}


@dataclass(frozen=True)
class Claim:
    """One claim: where it stands, what it says in our words, what is found, and whether that is so."""

    place: str
    says: str
    found: str
    verdict: str


def judged(place: str, says: str, found: str, holds: bool) -> Claim:
    """Give a claim its verdict."""
    return Claim(place, says, found, REPEATED if holds else NOT_REPEATED)


def straight_claims(replay: Replay) -> Iterator[Claim]:
    """Check what is said of the straight line."""
    place = "straight line"
    improvement = by_state(frame(replay.tables.improvement), "aided")["improvement_pct"]
    reached = by_state(frame(replay.tables.convergence), "aided")
    baseline = named(replay.histories, "baseline")
    aided = named(replay.histories, "aided")

    velocity = improvement[["dv_n", "dv_e", "dv_d"]]
    yield judged(
        place,
        "velocity errors are estimated alike by both filters",
        f"their sigmas differ by at most {velocity.abs().max():.1f} %",
        bool(velocity.abs().max() < 5.0),
    )
    yield judged(
        place,
        "the z accelerometer bias is known 53 % better",
        f"{improvement['ba_z']:.0f} %",
        abs(improvement["ba_z"] - 53.0) <= 3.0,
    )
    gyro = improvement[["bg_x", "bg_y"]]
    yield judged(
        place,
        "x and y gyro biases 48 %",
        f"{gyro['bg_x']:.0f} % and {gyro['bg_y']:.0f} %",
        bool((gyro - 48.0).abs().max() <= 3.0),
    )
    levelling = improvement[["phi_n", "phi_e"]]
    yield judged(
        place,
        "levelling nearly 7 %",
        f"{levelling['phi_n']:.1f} % and {levelling['phi_e']:.1f} %",
        bool((levelling - 7.0).abs().max() <= 2.0),
    )
    times_s = reached.loc[["ba_x", "ba_y"], "nearest_approach_s"]
    yield judged(
        place,
        "x and y accelerometer biases after 30 s as well known as by the baseline after 424 s",
        f"{times_s['ba_x']:.0f} s and {times_s['ba_y']:.0f} s",
        bool((times_s - 30.0).abs().max() <= 8.0),
    )
    tilt = INDEX["phi_n"]
    rows = np.flatnonzero(aided.updated)
    near = rows[
        np.argmin(
            np.abs(
                seconds(aided.time_ns[rows], aided.time_ns[0])
                - reached.loc["phi_n", "nearest_approach_s"]
            )
        )
    ]
    below_pct = 100.0 * (
        1.0 - aided.sd[near, tilt] / FACTOR["phi_n"] / reached.loc["phi_n", "target_sd"]
    )
    highest = aided.sd[near, tilt] >= 0.9999 * aided.sd[rows, tilt].max()
    yield judged(
        place,
        "roll and pitch converge after 99 s and 100 s",
        f"nearest to the target after {reached.loc['phi_n', 'nearest_approach_s']:.0f} s, at {below_pct:.1f} % below it"
        + (", where sigma is at its largest" if highest else ""),
        not highest,
    )
    left = {state: left_share(baseline, state) for state in ("ba_z", "bg_x", "bg_y")}
    yield judged(
        place,
        "z accelerometer bias and x and y gyro biases are observable",
        "left of their prior sigma: "
        + ", ".join(f"{name} {share:.1%}" for name, share in left.items()),
        max(left.values()) < 0.25,
    )
    hidden = {state: left_share(aided, state) for state in ("phi_d", "bg_z")}
    yield judged(
        place,
        "heading and z gyro bias are not, with accelerations either",
        "left with accelerations: "
        + ", ".join(f"{name} {share:.0%}" for name, share in hidden.items()),
        min(hidden.values()) > 0.95,
    )
    pairs = levelling_pairs(aided)
    yield judged(
        place,
        "levelling and horizontal accelerometer biases hang together",
        "correlation at the end: "
        + ", ".join(f"{name} {value:+.3f}" for name, value in pairs.items()),
        min(map(abs, pairs.values())) > 0.9,
    )


def eight_claims(eight: Replay, straight: Replay) -> Iterator[Claim]:
    """Check what is said of the figure-eight."""
    place = "figure-eight"
    aided = named(eight.histories, "aided")
    of_straight = named(straight.histories, "aided")
    before = sd_at(aided, "ba_x", 99.0)
    after = sd_at(aided, "ba_x", 130.0)
    yield judged(
        place,
        "the turn after 100 s makes the horizontal accelerometer biases known",
        f"sigma of ba_x {before:.2f} mg at 99 s, {after:.2f} mg at 130 s",
        after < 0.5 * before,
    )
    ends = [sd_at(history, "phi_n", np.inf) for history in (aided, of_straight)]
    yield judged(
        place,
        "levelling is known better than on the straight line",
        f"{ends[0]:.2f} mrad instead of {ends[1]:.2f} mrad at the end",
        ends[0] < 0.5 * ends[1],
    )
    improvement = by_state(frame(eight.tables.improvement), "aided")["improvement_pct"]
    accel = improvement[["ba_x", "ba_y", "ba_z"]]
    yield judged(
        place,
        "accelerometer biases are known 54 to 55 % better on all axes",
        ", ".join(f"{state} {change:.0f} %" for state, change in accel.items()),
        bool(accel.between(54.0 - 2.0, 55.0 + 2.0).all()),
    )
    level = improvement[["phi_n", "phi_e"]]
    yield judged(
        place,
        "levelling is known 51 % better",
        f"{level['phi_n']:.0f} % and {level['phi_e']:.0f} %",
        bool((level - 51.0).abs().max() <= 2.0),
    )
    left = left_share(aided, "bg_z")
    yield judged(
        place,
        "the z gyro bias stays unobservable",
        f"left of its prior sigma: {left:.1%}",
        left > 0.95,
    )


def lawnmower_claims(ensembles: tuple[Ensemble, ...], study: Result) -> Iterator[Claim]:
    """Check what is said of the Monte Carlo runs over legs and U-turns."""
    place = "S-manoeuvres, Monte Carlo"
    aided = named(ensembles, "aided")
    settled_s = max(settling_s(aided, state) for state in ("dv_n", "dv_e", "dv_d"))
    yield judged(
        place,
        "velocity errors converge at once",
        f"within a fifth of their sigma at 300 s after {settled_s:.1f} s",
        settled_s <= 10.0,
    )
    level = ensemble_sd(aided, "phi_n", 295.0)
    heading = ensemble_sd(aided, "phi_d", 295.0)
    level_0 = ensemble_sd(aided, "phi_n", 0.0)
    heading_0 = ensemble_sd(aided, "phi_d", 0.0)
    yield judged(
        place,
        "on the first leg levelling gets slightly better, heading worse",
        f"phi_n {level_0:.2f} to {level:.2f} mrad, phi_d {heading_0:.2f} to {heading:.2f} mrad",
        level < level_0 and heading > heading_0,
    )
    turned = larger_sd(aided, "phi_n", 360.0)
    yield judged(
        place,
        "the first U-turn makes levelling converge promptly",
        f"phi_n {turned:.2f} mrad at 360 s",
        turned < 0.5 * level,
    )
    turned = ensemble_sd(aided, "phi_d", 360.0)
    end = ensemble_sd(aided, "phi_d", np.inf)
    yield judged(
        place,
        "after it the heading error is gradually reduced",
        f"phi_d {heading:.2f} mrad before it, {turned:.2f} mrad at 360 s, {end:.2f} mrad at the end",
        end < turned < heading,
    )
    shares = {
        state: larger_sd(aided, state, np.inf) / ensemble_sd(aided, state, 0.0)
        for state in ("ba_x", "ba_y", "ba_z", "bg_x", "bg_y", "bg_z")
    }
    yield judged(
        place,
        "accelerometer biases converge fully, x and y gyro biases well, the z gyro bias more slowly",
        "left of the prior sigma: "
        + ", ".join(f"{name} {share:.1%}" for name, share in shares.items()),
        max(shares[name] for name in ("ba_x", "ba_y", "ba_z")) < 0.1
        and shares["bg_z"] > shares["bg_x"],
    )
    table = study.tables["montecarlo"]
    rows = table[table["filter"] == "aided"]
    off = float((rows["ensemble_mean"].abs() / rows["ensemble_sd"]).max())
    yield judged(
        place,
        "the mean over the runs stays near zero",
        f"at the end at most {off:.2f} of the ensemble's sigma",
        off < 0.4,
    )
    for filter_, who in (
        ("aided", "sigma from P and over the runs are alike"),
        ("baseline", "so they are for the baseline"),
    ):
        ratio = table.loc[table["filter"] == filter_, "ratio"]
        verdict = by_filter(study.tables["verdicts"], filter_)
        yield judged(
            place,
            who,
            f"{filter_}: rms error over sigma at the end {ratio.min():.2f} to {ratio.max():.2f}; mean NEES "
            f"{verdict['mean_nees']:.1f}, consistent filters have {verdict['low']:.1f} to {verdict['high']:.1f}: "
            f"{verdict['verdict']}",
            verdict["verdict"] == "consistent",
        )


def window_claims(study: Result) -> Iterator[Claim]:
    """Check how many velocities make the best acceleration, on all dives together."""
    windows = study.tables["window"]
    best = study.tables["best"]
    rows = windows[(windows["log"] == "*") & (windows["lever_arm"] == "compensated")]
    optimum = best[(best["log"] == "*") & (best["lever_arm"] == "compensated")].set_index("at")
    for at, where in (
        ("middle", "at the middle of the window"),
        ("end", "at its end, where it is used"),
    ):
        rmse = rows[rows["at"] == at].set_index("n")["rmse_mps2"]
        n = int(optimum.loc[at, "n"])
        falls_and_rises = rmse.index[0] < n < rmse.index[-1]
        yield judged(
            "past DVL measurements",
            f"the error falls and rises with n, {where}",
            f"{rmse.iloc[0]:.4f} m/s² for n = {rmse.index[0]}, {rmse[n]:.4f} for {n}, {rmse.iloc[-1]:.4f} for "
            f"{rmse.index[-1]}",
            bool(falls_and_rises),
        )
        yield judged(
            "past DVL measurements", f"three velocities are best, {where}", f"{n}", n == 3
        )


def observability_claims(study: Result) -> Iterator[Claim]:
    """Check what is said of ranks and unobservable subspaces."""
    place = "observability"
    rank = study.tables["ranks"].set_index("aiding")["rank"]
    yield judged(
        place,
        "the unobservable subspace of accelerations is that of velocities",
        f"rank {rank['velocity']} of 12 for velocities, {rank['published']} for accelerations alone",
        bool(rank["velocity"] == rank["published"]),
    )
    yield judged(
        place,
        "accelerations next to velocities do not change what is observable",
        f"rank {rank['velocity']}, with accelerations {rank['velocity + published']}",
        bool(rank["velocity"] == rank["velocity + published"]),
    )


def conclusion_claims(
    straight: pd.DataFrame, eight: pd.DataFrame, grades: Mapping[str, Result]
) -> Iterator[Claim]:
    """Check what the conclusion says of all states, and of sensors of a lower grade.

    Parameters
    ----------
    straight, eight : DataFrame
        The aided filter's rows of the table of improvements, by state.
    grades : mapping of str to Result
        Monte Carlo studies by grade of the IMU, the best first.
    """
    place = "conclusion"
    for name, improvement in (("straight line", straight), ("figure-eight", eight)):
        nine = improvement.loc[[state.id for state in NINE], "improvement_pct"]
        same = [state for state, change in nine.items() if change < SAME_PCT_SHOWN]
        yield judged(
            place,
            f"accuracy improves on all error states, {name}",
            f"smallest gain in sigma {nine.min():.1f} %"
            + (f"; below 1 %: {', '.join(map(str, same))}" if same else ""),
            not same,
        )
    studies = list(grades.items())
    for (better, with_better), (worse, with_worse) in pairwise(studies):
        ratio = error_over_better(with_worse, with_better)
        yield judged(
            place,
            f"sensors of a lower grade become usable: {worse} in place of {better}",
            f"with accelerations, errors of {worse} are {ratio:.1f} times those of {better} without",
            ratio <= 1.0,
        )
    yield Claim(place, "only software is needed", "so it is here: the same readings", REPEATED)


def error_over_better(worse: Result, better: Result) -> float:
    """Return the true errors of the aided filter over those of the baseline with a better IMU.

    It is the geometric mean over the nine states, rms over the runs at the end.
    """
    with_accelerations = errors_of(worse, "aided")
    without = errors_of(better, "baseline")
    return float(np.exp(np.log(with_accelerations / without).mean()))


def errors_of(study: Result, filter_: str) -> pd.Series:
    """Return the rms errors of a filter at the end, of the nine states."""
    table = study.tables["montecarlo"]
    rows = table[(table["filter"] == filter_) & table["state"].isin([state.id for state in NINE])]
    return rows.set_index("state")["rms_error"]


def sea_claims(dives: list[Replay]) -> Iterator[Claim]:
    """Check, on dives of the same vehicle, what is said to follow for the navigation."""
    predicted = [mean_over(replay, "improvement", "windowed") for replay in dives]
    yield Claim(
        "sea experiments",
        "40 % smaller estimated errors where the vehicle turns",
        f"other segments of the same day: {min(predicted):.0f} % to {max(predicted):.0f} %, median "
        f"{float(np.median(predicted)):.0f} %",
        REPEATED if abs(float(np.median(predicted)) - 40.0) <= 5.0 else NOT_REPEATED,
    )
    errors = position_errors(dives)
    for name, how in (("windowed", "slope predicted"), ("published", "as printed")):
        better = int((errors[name] < 0.95 * errors["baseline"]).sum())
        yield judged(
            "conclusion",
            f"accuracy gets better, {how}",
            f"position error against the reference at least 5 % smaller on {better} of {len(errors)} dives, median "
            f"{errors['baseline'].median():.2f} m before and {errors[name].median():.2f} m after",
            better > len(errors) / 2,
        )


def position_errors(dives: list[Replay]) -> pd.DataFrame:
    """Give the rms position error of each filter in each dive, m."""
    rows = {}
    for replay in dives:
        table = frame(replay.tables.reference_error)
        table = table[table["quantity"] == "position_h"].set_index("filter")
        rows[replay.dive.name] = {
            "baseline": table["baseline_rmse"].iloc[0],
            **table["rmse"].to_dict(),
        }
    return pd.DataFrame.from_dict(rows, orient="index")


def mean_nis(dives: list[Replay]) -> pd.Series:
    """Give the mean NIS of the first filter's velocities in each dive."""
    return pd.Series({replay.dive.name: replay.tables.consistency[0].mean_nis for replay in dives})


def mean_over(replay: Replay, table: str, filter_: str = "aided") -> float:
    """Give the paper's mean over nine states; what did not improve counts as 0."""
    return mean_over_nine(getattr(replay.tables, table), filter_)


def frame(rows: Sequence[Struct]) -> pd.DataFrame:
    """Give the rows of a table as pandas has them."""
    return pd.DataFrame([msgspec.to_builtins(row) for row in rows])


def by_state(table: pd.DataFrame, filter_: str) -> pd.DataFrame:
    """Give a filter's rows, by state."""
    return table[table["filter"] == filter_].set_index("state")


def by_filter(table: pd.DataFrame, filter_: str) -> Mapping[str, float]:
    """Give the one row of a filter."""
    return table.set_index("filter").loc[filter_].to_dict()


def named(items, name: str):
    """Give the history or ensemble of a filter."""
    return next(item for item in items if item.filter == name)


def sd_at(history: History, state: str, time_s: float) -> float:
    """Give the last sigma up to a time, shown unit."""
    since_s = (history.time_ns - history.time_ns[0]) * 1e-9
    row = np.flatnonzero(history.updated & (since_s <= time_s))[-1]
    return float(history.sd[row, INDEX[state]] / FACTOR[state])


def left_share(history: History, state: str) -> float:
    """Give the final sigma as a share of the first."""
    return float(sd_at(history, state, np.inf) * FACTOR[state] / history.sd[0, INDEX[state]])


def levelling_pairs(history: History) -> dict[str, float]:
    """Give the correlation of each horizontal accelerometer bias with the misalignment about the other body axis."""
    row = np.searchsorted(history.time_ns, history.cov_ns[-1])
    to_body = np.eye(12)
    to_body[3:6, 3:6] = history.mat_nb[row].T
    cov = to_body @ history.cov[-1] @ to_body.T
    sd = np.sqrt(np.diag(cov))
    pairs = {
        "ba_x with the tilt about y": (INDEX["ba_x"], 4),
        "ba_y with that about x": (INDEX["ba_y"], 3),
    }
    return {
        name: float(cov[bias, tilt] / (sd[bias] * sd[tilt]))
        for name, (bias, tilt) in pairs.items()
    }


def ensemble_sd(ensemble: Ensemble, state: str, time_s: float) -> float:
    """Give the last sigma from P up to a time, shown unit."""
    row = np.flatnonzero(ensemble.time_s <= time_s)[-1]
    return float(ensemble.sd[row, INDEX[state]] / FACTOR[state])


def larger_sd(ensemble: Ensemble, state: str, time_s: float) -> float:
    """Give sigma from P or that over the runs up to a time, whichever is larger: P alone may be overconfident."""
    row = np.flatnonzero(ensemble.time_s <= time_s)[-1]
    larger = max(ensemble.sd[row, INDEX[state]], ensemble.error_sd[row, INDEX[state]])
    return float(larger / FACTOR[state])


def settling_s(ensemble: Ensemble, state: str) -> float:
    """Give the time after which sigma stays within a fifth of what it is at 300 s, on the first leg."""
    leg = ensemble.time_s <= 300.0
    sd = ensemble.sd[leg, INDEX[state]]
    outside = np.flatnonzero(np.abs(sd / sd[-1] - 1.0) > 0.2)
    return float(ensemble.time_s[leg][outside[-1] + 1]) if len(outside) else 0.0
