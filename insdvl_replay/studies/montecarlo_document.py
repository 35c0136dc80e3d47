"""A Monte Carlo study for people: what each filter believes of its errors, and what they are."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

import pandas as pd

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.quantities import label
from insdvl_replay.core.states import NINE, STATES, State
from insdvl_replay.core.words import Consistency
from insdvl_replay.report.document import DisplayTable, number, percent
from insdvl_replay.report.plots.panel import LIMIT, REFERENCE, Curve, Figure, Panel, filter_style

BELIEVED: Final = f"{filter_style(0)} {filter_style(1)}"
"""The dashes of the first filter in the blue of the second, as in the paper."""
MEAN: Final = filter_style(2)
SETTLED: Final = 0.02
"""Share of the dive after which a panel shows everything; before, a sigma may fall from fifty times as high."""
FAR_ABOVE: Final = 10.0
"""A NEES this many times above the interval is drawn on a logarithmic scale, which shows the others, too."""


def montecarlo_sentences(tables: Mapping[str, pd.DataFrame]) -> tuple[str, ...]:
    """State of each filter whether it is as good as it says, and of each candidate whether it is better."""
    verdicts = [_verdict(row) for row in tables["verdicts"].itertuples()]
    baseline, *candidates = tables["verdicts"]["filter"]
    return (*verdicts, *(_improvement(tables["montecarlo"], name, baseline) for name in candidates))


def _verdict(row: Any) -> str:
    judged = (
        f"{row.filter}: too few runs to judge it"
        if row.verdict == Consistency.TOO_FEW
        else f"{row.filter} is {row.verdict}" + (f" ({row.why} of what is expected)" if row.why else "")
    )
    return (
        f"{judged}; mean NEES {row.mean_nees:.4g} over {row.runs} runs, where 95 % of consistent filters have "
        f"{row.low:.4g} to {row.high:.4g}; inside at {row.inside_pct:.0f} % of the pings"
    )


def _improvement(table: pd.DataFrame, name: str, baseline: str) -> str:
    rows = table[(table["filter"] == name) & table["state"].isin([state.id for state in NINE])]
    believed, true = (rows[f"{kind}_improvement_pct"].mean() for kind in ("believed", "true"))
    return (
        f"{name} believes in errors that are {_change(believed)} than those of {baseline} in the mean over nine "
        f"states; they are {_change(true)}"
    )


def _change(improvement_pct: float) -> str:
    return f"{abs(improvement_pct):.1f} % {'smaller' if improvement_pct >= 0 else 'larger'}"


def montecarlo_display(tables: Mapping[str, pd.DataFrame]) -> tuple[DisplayTable, ...]:
    """Turn the tables of a study into tables for people: one for each filter, and the verdicts."""
    baseline, *_ = tables["verdicts"]["filter"]
    states = [
        _states(name, rows, "" if name == baseline else baseline)
        for name, rows in tables["montecarlo"].groupby("filter", sort=False)
    ]
    through = (_outages(tables["outages"]),) if "outages" in tables else ()
    return (*states, _verdicts(tables["verdicts"]), *through)


def _states(name: object, rows: pd.DataFrame, baseline: str) -> DisplayTable:
    header = ["state", "unit", "sigma\nfrom P", "ensemble\nsigma", "ensemble\nmean", "rms /\nsigma"]
    columns = ["final_sd", "ensemble_sd", "ensemble_mean", "ratio"]
    shares = ["believed_improvement_pct", "true_improvement_pct"] if baseline else []
    against = f"; improvement over {baseline} in belief and truth" if baseline else ""
    return DisplayTable(
        f"Errors of {name} at the end, as believed and as they are{against}",
        (*header, *(["belief", "truth"] if baseline else [])),
        "llrrrr" + "rr" * bool(baseline),
        tuple(
            (
                label(row["state"]),
                row["unit"],
                *(number(row[column]) for column in columns),
                *(percent(row[column]) for column in shares),
            )
            for row in rows.to_dict("records")
        ),
    )


def _verdicts(table: pd.DataFrame) -> DisplayTable:
    return DisplayTable(
        "NEES: mean over runs and pings, and where 95 % of consistent filters would have it",
        ("filter", "runs", "NEES", "low", "high", "inside", "at the end", "verdict"),
        "lrrrrrrl",
        tuple(
            (
                row["filter"],
                str(row["runs"]),
                *(number(row[column]) for column in ("mean_nees", "low", "high")),
                percent(row["inside_pct"]),
                number(row["final_nees"]),
                row["verdict"],
            )
            for row in table.to_dict("records")
        ),
    )


def _outages(table: pd.DataFrame) -> DisplayTable:
    columns = ["nees_before", "nees_last", "nees_soon", "nees_later", "nees_final"]
    return DisplayTable(
        f"NEES through outages of the DVL, mean over the runs; {len(STATES)} expected",
        ("filter", "from\n[s]", "to\n[s]", "before", "last in\nit", "after\n1.5 s", "after\n60 s", "at the\nend"),
        "lrrrrrrr",
        tuple(
            (row["filter"], f"{row['start_s']:g}", f"{row['end_s']:g}", *(number(row[column]) for column in columns))
            for row in table.to_dict("records")
        ),
    )


def run_sentences(table: pd.DataFrame) -> tuple[str, ...]:
    """State of each filter what its NEES was in one run."""
    return tuple(
        f"{row['filter']}: NEES {row['mean_nees']:.4g} in the mean over the pings, {row['final_nees']:.4g} at the end "
        f"({len(STATES)} expected)"
        for row in table.drop_duplicates("filter").to_dict("records")
    )


def run_display(table: pd.DataFrame) -> tuple[DisplayTable, ...]:
    """Turn one run into tables for people, one for each filter."""
    return tuple(
        DisplayTable(
            f"Errors of {name} at the end of the run",
            ("state", "unit", "error", "sigma from P", "error / sigma"),
            "llrrr",
            tuple(
                (label(row["state"]), row["unit"], *(number(row[column]) for column in ("error", "sd", "ratio")))
                for row in rows.to_dict("records")
            ),
        )
        for name, rows in table.groupby("filter", sort=False)
    )


def nees_figure(title: str, nees: pd.DataFrame) -> Figure:
    """Draw the mean NEES of each filter over time, from `ensemble_tables.nees_table`, with its interval."""
    names = list(nees["filter"].unique())
    low, high = float(nees["low"][0]), float(nees["high"][0])
    far_above = nees["mean_nees"].max() > FAR_ABOVE * high
    panel = Panel(
        "mean NEES",
        "time [s]",
        tuple(
            Curve(rows["time_s"].to_numpy(), rows["mean_nees"].to_numpy(), filter_style(number))
            for number, (_, rows) in enumerate(nees.groupby("filter", sort=False))
        ),
        levels=(low, high),
        y_scale="log" if far_above else "linear",
    )
    legend = [(filter_style(number), name) for number, name in enumerate(names)]
    caption = "Between the dashed lines lie 95 % of consistent filters."
    return Figure(title, caption, (panel,), (*legend, (LIMIT, "95 % interval")))


def ensemble_figure(
    title: str, states: Sequence[State], time_s: Floats, sd: Floats, error_sd: Floats, error_mean: Floats
) -> Figure:
    """Draw sigma from P, ensemble sigma and ensemble mean over time, one panel for each state.

    Parameters
    ----------
    time_s : ndarray, shape (k,)
    sd, error_sd, error_mean : ndarray, shape (k, 12)
        SI units.
    """
    panels = []
    for state in states:
        columns = [column[:, state.index] / state.factor for column in (sd, error_sd, error_mean)]
        believed, actual, mean = columns
        settled = time_s >= SETTLED * time_s[-1]
        lowest, highest = min(0.0, mean[settled].min()), max(believed[settled].max(), actual[settled].max())
        curves = (Curve(time_s, actual, REFERENCE), Curve(time_s, mean, MEAN), Curve(time_s, believed, BELIEVED))
        y_limits = (1.1 * lowest - 0.1 * highest, 1.1 * highest)
        panels.append(Panel(f"{state.label} [{state.unit}]", "time [s]", curves, y_limits=y_limits))
    return Figure(
        title,
        "Where the sigma from P lies on that of the ensemble, the filter is as good as it says.",
        tuple(panels),
        ((BELIEVED, "sigma from P"), (REFERENCE, "ensemble sigma"), (MEAN, "ensemble mean")),
    )
