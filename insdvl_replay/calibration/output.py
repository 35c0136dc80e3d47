"""A calibration as screen, JSON, settings and pictures."""

import shlex
from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from typing import Any, Final

import msgspec
import numpy as np

from insdvl_replay.calibration.calibration import AXES, Calibration, ReferenceCalibration
from insdvl_replay.calibration.certainty import correlation_matrix, mean_change, one_by_one
from insdvl_replay.calibration.dives import Answer, answer_of
from insdvl_replay.calibration.fit import delay_profile
from insdvl_replay.calibration.innovations import (
    DELAY,
    LABELS,
    LATEST_S,
    NO_CHANGE,
    PARAMETERS,
    SHARED,
    SKIPPED,
    DiveInnovations,
    Geometry,
)
from insdvl_replay.calibration.new_settings import new_settings_table, vehicle_figure
from insdvl_replay.calibration.noise import INERTIAL
from insdvl_replay.calibration.rows import (
    DiveRow,
    HeldOutRow,
    NoiseRow,
    ParameterRow,
    ReferenceDiveRow,
    StartRow,
)
from insdvl_replay.core.config import Config
from insdvl_replay.core.config_file import toml_value
from insdvl_replay.core.dive_columns import NS_PER_S, Floats
from insdvl_replay.core.errors import counted, visible
from insdvl_replay.core.version import __version__
from insdvl_replay.core.words import Estimated
from insdvl_replay.document.parts import (
    LIMIT,
    PAGE,
    PRINTED,
    REFERENCE,
    Code,
    Curve,
    DisplayTable,
    Figure,
    Heading,
    Only,
    Panel,
    Part,
    Remark,
    Result,
    Sentences,
    Title,
    filter_style,
)
from insdvl_replay.document.tables import number, shown, signed_number, table_of
from insdvl_replay.document.time_axis import Clock
from insdvl_replay.preparation.run import FIT

DIGITS: Final = 6  # decimals of proposed values, finer than any sd
NOT_ESTIMATED: Final = "Nothing could be estimated: these dives have no suitable manoeuvre."
SEE_MORE: Final = "what the intervals come from, and correlations: -v"
_KEPT: Final = {Estimated.HELD: "held; ", Estimated.IMPLAUSIBLE: "not proposed; "}
_KEYS: Final = {parameter.name: parameter.key for parameter in SHARED}


def calibration_result(
    found: Calibration,
    config: Config,
    written: str = "",  # the settings file
    options: str = "",  # of `run`, with which it has the settings that were given
    figures: Sequence[Figure] = (),
    *,
    even_if_worse: bool = False,  # what is worse on held-out dives is written too
    verbose: bool = False,
) -> Result:
    """Return the answer, estimates, tables and warnings."""
    answer = answer_of(found)
    names = _estimated(found)
    estimated = f"Estimated: {', '.join(names)}." if names else NOT_ESTIMATED
    reasons = [*_reasons(found), *map(Remark, found.warnings)]
    title = f"Calibration of the DVL from {counted(len(found.dives), 'dive')}"
    parts: list[Part] = [Title(title), *answer.lines]
    if names:
        applied = found if even_if_worse else answer.applied(found)
        parts += _to_copy(applied, written, options)
        parts += _left_out(written, answer, even_if_worse=even_if_worse)
    else:
        parts.append(estimated)
    if found.tried:
        parts.append(f"The mounting was unknown: {found.tried}.")
    parts += vehicle_figure(found)
    parts += _new_settings(found)
    if reasons:
        parts.append(Sentences(tuple(reasons)))
    parts += _between_the_dives(found, is_drawn=bool(figures))
    certainties = tuple(_certainties(found))
    if verbose:
        parts += certainties
    else:
        parts += [Only(PRINTED, (SEE_MORE,)), Only(PAGE, certainties)]
    if figures:
        parts += [Heading("Pictures"), *figures]
    return Result(
        "calibration",
        title,
        [*answer.lines, estimated, *reasons],
        _blocks(found),
        config=config,
        facts=_facts(found, answer),
        document=parts,
    )


def _estimated(found: Calibration) -> list[str]:
    """Name the parameters that are proposed, and the noise."""
    names = [LABELS[row.parameter] for row in found.estimated]
    if found.proposes_noise:
        names.append("noise")
    return names


def _to_copy(found: Calibration, written: str, options: str) -> Iterator[Part]:
    """Yield how to use the settings file, and on pages and without such a file the settings themselves."""
    lines = [line for line in _setting_lines(found) if not line.startswith("#")]
    settings = Code("\n".join(lines).strip("\n"), "toml")
    if written:
        words = ["insdvl-replay run LOG", options, f"-c {shlex.quote(written)}"]
        command = " ".join(word for word in words if word)
        yield f"Nothing is applied automatically. To use it: `{command}`"
        yield Only(PAGE, (settings,))
    else:
        yield "Nothing is applied automatically. To use it, copy this into your settings:"
        yield settings


def _left_out(written: str, answer: Answer, *, even_if_worse: bool) -> Iterator[str]:
    """Say what the new settings leave out, since it is worse on held-out dives."""
    left_out = []
    if answer.keeps_geometry:
        left_out.append("geometry")
    if answer.keeps_noise:
        left_out.append("noise")
    if left_out and not even_if_worse:
        what = written or "This"
        yield f"{what} leaves out the new {' and '.join(left_out)}. To write all: --even-if-worse"


def _blocks(found: Calibration) -> dict[str, Sequence[Any]]:
    """Return the tables that have rows."""
    tables: dict[str, Sequence[Any]] = {
        "parameters": found.all_rows,
        "noise": found.noise_rows,
        "dives": found.dives,
        "held_out": found.held_out,
    }
    if found.reference is not None:
        tables["reference"] = found.reference.dives
        tables["starts"] = found.reference.starts
    return {name: rows for name, rows in tables.items() if rows}


def _facts(found: Calibration, answer: Answer) -> dict[str, Any]:
    """Return the settings before and after, and what becomes of them."""
    before: dict[str, Any] = {"dvl": found.before}
    after: dict[str, Any] = {"dvl": found.after}
    if found.reference is not None:
        before["reference"] = _without_scale(found.reference.before)
        after["reference"] = _without_scale(found.reference.after)
    return {
        "before": before,
        "after": after,
        "warnings": found.warnings,
        "keeps_geometry": answer.keeps_geometry,
        "keeps_noise": answer.keeps_noise,
    }


def _without_scale(geometry: Geometry) -> dict[str, Any]:
    """Return the settings of a reference, which has no scale."""
    settings = msgspec.structs.asdict(geometry)
    del settings["scale"]
    return settings


def _reasons(found: Calibration) -> list[Remark]:
    """Return why parameters are not proposed, grouped by reason."""
    names: dict[str, list[str]] = {}
    for status, what in _KEPT.items():
        for row in found.all_rows:
            if row.status == status:
                names.setdefault(what + row.why, []).append(LABELS[row.parameter])
    kept = (Estimated.HELD, Estimated.NOT_DETERMINED, Estimated.OF_CLASS)
    for noise in found.noise_rows:
        if noise.status in kept:
            names.setdefault(noise.why, []).append(noise.parameter)
    return [Remark(f"{', '.join(same)}: {why}") for why, same in names.items()]


# --- The tables of the screen.


def _new_settings(found: Calibration) -> Iterator[DisplayTable]:
    """Yield what is proposed, before and after, with intervals: the geometry, the noise and the reference."""
    asked = [row for row in found.rows if row.status != Estimated.NOT_ASKED]
    if asked:
        title = "New settings of the DVL; x forward, y starboard, z down"
        yield new_settings_table(title, asked, found.before, found.after)
    is_asked = all(row.status != Estimated.NOT_ASKED for row in found.noise_rows)
    yield table_of(
        "White noise with the highest likelihood of the innovations",
        found.noise_rows,
        (
            ("", "l", lambda row: f"{row.parameter} [{row.unit}]"),
            ("before", "r", "before"),
            ("new", "r", _noise_after),
            ("sd", "r", "sd"),
            ("class", "l", "sensor_class"),
        ),
        "" if is_asked else "Not requested. It is used only to weigh the innovations.",
    )
    reference = found.reference
    if reference is not None:
        title = "New settings of the reference"
        yield new_settings_table(title, reference.rows, reference.before, reference.after)


def _between_the_dives(found: Calibration, *, is_drawn: bool) -> Iterator[Part]:
    """Yield what differs between the dives: the estimates of each, its innovations, what is left of its errors."""
    yield Heading("What differs between the dives")
    if is_drawn:
        yield from each_alone(found)
    yield table_of(
        f"Innovations in standard deviations of the fitted noise, {', '.join(AXES)}",
        found.dives,
        (
            ("dive", "l", "dive"),
            ("pings", "r", "pings"),
            ("left\nout", "r", "left_out"),
            ("delay\n[s]", "r", "delay_s"),
            ("before", "r", partial(_axes, "before")),
            ("after", "r", partial(_axes, "after")),
            ("lag-1\ncorrelation", "r", partial(_axes, "autocorrelation")),
        ),
        "With the right settings these are near 1, and the lag-1 correlation is near 0.",
        spare=((1, 2), 6),
    )
    if found.reference is not None:
        yield shown(ReferenceDiveRow, found.reference.dives)
        if found.reference.starts:
            yield shown(StartRow, found.reference.starts)
    if found.held_out:
        yield shown(HeldOutRow, found.held_out)


def _certainties(found: Calibration) -> Iterator[DisplayTable]:
    """Yield what the intervals come from, folded on pages."""
    yield _parameter_table("Changes, and what their standard deviations come from", found.rows)
    if found.reference is not None:
        title = "The same of the reference"
        yield _parameter_table(title, found.reference.rows)
    if found.fit.free.any():
        yield _correlation_table(found)


def _parameter_table(title: str, rows: Sequence[ParameterRow]) -> DisplayTable:
    table = table_of(
        title,
        [row for row in rows if row.status != Estimated.NOT_ASKED],
        (
            ("parameter", "l", lambda row: f"{LABELS[row.parameter]} [{row.unit}]"),
            ("change", "r", _change),
            ("sd", "r", "sd"),
            ("formal", "r", "formal_sd"),
            ("corre-\nlated", "r", "correlated_sd"),
            ("between\ndives", "r", "between_dives_sd"),
            ("signal /\nnoise", "r", "signal_to_noise"),
        ),
        "sd: the largest of the three, plus assumed errors of each beam (0.2 % and 1 mm/s) and of the IMU (1500 ppm "
        "and 1 mrad). A parameter is held if its signal to noise is below 3 (mounting 4, scale 30).",
    )
    return replace(table, folded=True)


def _change(row: ParameterRow) -> str:
    if row.status == Estimated.HELD or row.change is None:
        return Estimated.HELD
    mark = "?" if row.status == Estimated.IMPLAUSIBLE else ""
    return f"{signed_number(row.change)}{mark}"


def _correlation_table(found: Calibration) -> DisplayTable:
    """Return the correlations of the fitted parameters, each pair once."""
    free = np.flatnonzero(found.fit.free)
    matrix = correlation_matrix(found.fit)
    names = [PARAMETERS[row].label for row in free]
    rows = []
    for row, name in zip(free[1:], names[1:], strict=True):
        cells = [f"{matrix[row, column]:+.2f}" if column < row else "" for column in free[:-1]]
        rows.append((name, *cells))
    title = "Correlations of the estimates; near -1 or +1 the dives cannot separate two parameters"
    header = ("", *(name.replace(" ", "\n") for name in names[:-1]))
    return DisplayTable(title, header, f"l{'r' * (len(names) - 1)}", tuple(rows), folded=True)


def _axes(name: str, row: DiveRow) -> str:
    return " ".join(f"{value:.2f}" for value in row.axes(name))


def _noise_after(row: NoiseRow) -> str:
    if row.status == Estimated.NOT_DETERMINED:
        if row.is_proposed:
            return f"at most {number(row.after)}"
        return Estimated.NOT_DETERMINED
    shown = (Estimated.ESTIMATED, Estimated.OF_CLASS, Estimated.NOT_ASKED)
    if row.status in shown:
        return number(row.after)
    return Estimated.HELD


# --- The settings.


def calibration_toml(found: Calibration, started_ns: Sequence[int]) -> str:
    """Write the proposed settings as TOML for ``-c``, each with its sd or the reason why it is held.

    ``started_ns``: start of each dive since 1970, on its own clock.
    """
    names = ", ".join(visible(dive.dive) for dive in found.dives)
    dives = counted(len(found.dives), "dive")
    head = f"# insdvl-replay {__version__} calibrate: {dives} of {_days(started_ns)}: {names}"
    return "".join(f"{line}\n" for line in (head, *_setting_lines(found)))


def _setting_lines(found: Calibration) -> list[str]:
    """Return the proposed settings as lines of TOML, each below the comment on its certainty."""
    lines = ["[dvl]", *_geometry_lines(found.rows, found.before, found.after)]
    of_imu: list[str] = []
    for row in found.noise_rows:
        if row.parameter in INERTIAL:
            of_imu += _noise_lines(row)
        else:
            lines += _noise_lines(row)
    if found.proposes_noise:
        lines += ["", "[noise]", *of_imu]
    if found.reference is not None:
        lines += _reference_lines(found.reference)
    lines += [f"# warning: {visible(warning)}" for warning in found.warnings]
    return lines


def _days(started_ns: Sequence[int]) -> str:
    """Return the first and the last day of some dives, or the only one."""
    days = set()
    for start_ns in started_ns:
        days.add(datetime.fromtimestamp(start_ns / NS_PER_S, UTC).date().isoformat())
    first = min(days)
    last = max(days)
    if first == last:
        return first
    return f"{first} to {last}"


def _reference_lines(reference: ReferenceCalibration) -> Iterator[str]:
    """Write the settings of a reference, and the headings at the start by its positions."""
    yield from ("", "[reference]")
    yield from _geometry_lines(reference.rows, reference.before, reference.after)
    if not reference.starts:
        return
    yield from ("", "[initial]")
    for start in reference.starts:
        yield (
            f"# {visible(start.dive)}: heading {start.heading_deg:g} deg, sd {start.heading_sd_deg:.2g} deg; gyro "
            f"bias "
            f"about down {start.gyro_bias_degph:g} deg/h, sd {start.gyro_bias_sd_degph:.2g} deg/h"
        )
    yield f"heading_deg = {toml_value(FIT)}"


def _geometry_lines(
    rows: Sequence[ParameterRow], before: Geometry, after: Geometry
) -> Iterator[str]:
    for key in Geometry.__struct_fields__:
        own = [row for row in rows if _KEYS[row.parameter] == key]
        old = getattr(before, key)
        new = getattr(after, key)
        if old == new and all(row.status == Estimated.NOT_ASKED for row in own):
            continue
        yield from (f"# {_comment(row)}" for row in own)
        if old != new or any(row.status == Estimated.ESTIMATED for row in own):
            if isinstance(new, tuple):
                pairs = zip(old, new, strict=True)
                value: object = tuple(_rounded(was, now) for was, now in pairs)
            else:
                value = _rounded(old, new)
            yield f"{key} = {toml_value(value)}"


def _rounded(before: float, after: float) -> float:
    """Drop insignificant digits; an unchanged value stays equal to the bit."""
    if after == before:
        return after
    return round(after, DIGITS)


def _comment(row: ParameterRow) -> str:
    match row.status:
        case Estimated.NOT_ASKED:
            return f"{row.parameter}: not requested"
        case Estimated.HELD | Estimated.NOT_DETERMINED | Estimated.OF_CLASS:
            return f"{row.parameter}: unchanged; {row.why}"
        case Estimated.IMPLAUSIBLE:
            return f"{row.parameter}: unchanged; {row.change:+.4g} {row.unit} was found and rejected: {row.why}"
        case Estimated.ESTIMATED:
            sure = f"sd {row.sd:.2g} {row.unit}, signal to noise {row.signal_to_noise:.0f}"
            return f"{row.parameter}: {row.change:+.4g} {row.unit}, {sure}"


def _noise_lines(row: NoiseRow) -> Iterator[str]:
    before = f"before: {row.before:.4g} {row.unit}"
    if row.status == Estimated.ESTIMATED:
        sd = "" if row.sd is None else f", sd {row.sd:.2g} {row.unit}"
        known_class = f", class {row.sensor_class}" if row.sensor_class else ""
        yield f"# highest likelihood of the innovations{sd}; {before}{known_class}"
    elif row.status in (Estimated.NOT_DETERMINED, Estimated.OF_CLASS, Estimated.IMPLAUSIBLE):
        yield f"# {row.parameter}: {row.why}; {before}"
    if row.is_proposed:
        yield f"{row.parameter} = {toml_value(row.after)}"


# --- The pictures.

DRAWN: Final = 6  # number of dives that are drawn; the tables list all of them
BEFORE: Final = filter_style(1)
AFTER: Final = filter_style(0)
_LEGEND: Final = ((BEFORE, "before"), (AFTER, "after"))
_PROFILE_S: Final = np.linspace(-LATEST_S, LATEST_S, 17)
_SHARE: Final = 0.995  # share of the innovations inside a panel, without outliers
_AIR: Final = 1.2
_CAPTION: Final = "Predicted minus measured velocity in standard deviations, without any pattern if the result is good."
_PLACES: Final = "dive, in the order of the table"


def calibration_figures(
    found: Calibration, dives: Sequence[DiveInnovations]
) -> tuple[Figure, ...]:
    """Draw innovations before and after, the cost of a delay, and drift in outages."""
    figures = []
    profiles = []
    for i, dive in enumerate(found.noise.applied(dive) for dive in dives[:DRAWN]):
        change = found.change_of_dive(i)
        clock = Clock(dive.prepared.alignment.start_ns, dive.prepared.end_ns)
        time = clock.time(dive.prepared.velocities.time_ns[SKIPPED:-SKIPPED])
        panels = []
        for axis, *pair in zip(
            AXES, dive.residuals(NO_CHANGE).T, dive.residuals(change).T, strict=True
        ):
            curves = tuple(
                Curve(time, values, style)
                for values, style in zip(pair, (BEFORE, AFTER), strict=True)
            )
            height = _AIR * float(np.quantile(np.abs(np.concatenate(pair)), _SHARE))
            panels.append(
                Panel(f"innovation {axis} [sd]", clock.label, curves, y_limits=(-height, height))
            )
        figures.append(Figure(f"Innovations of {dive.name}", _CAPTION, tuple(panels), _LEGEND))
        # The cost of a delay above its minimum, with all other parameters as estimated.
        delays_s = np.union1d(_PROFILE_S, change[DELAY])
        costs = delay_profile(dive, change, delays_s)
        costs = costs - costs.min()
        proposed = Curve(np.repeat(change[DELAY], 2), np.array([0.0, costs.max()]), REFERENCE)
        curves = (Curve(delays_s, costs, AFTER), proposed)
        profiles.append(Panel(dive.name, "delay [s], change from the configuration", curves))
    costs_figure = Figure(
        "Cost of the delay",
        "Sum of the squared innovations above its minimum; outliers have less weight. With one deep minimum the "
        "delay is certain, but not with several minima or a flat curve.",
        tuple(profiles),
        ((AFTER, "cost"), (REFERENCE, "as fitted")),
    )
    return (*figures, costs_figure, *_drifts(found.held_out))


def each_alone(found: Calibration) -> Iterator[Figure]:
    """Draw the estimate of each dive alone; nothing for one dive."""
    own, own_sd = one_by_one(found.fit)
    common = mean_change(found.fit)
    drawn = found.fit.free
    if len(own) < 2 or not drawn.any():
        return
    place = np.arange(1.0, len(own) + 1.0)
    panels = []
    for row in np.flatnonzero(drawn):
        parameter = PARAMETERS[row]
        value = parameter.shown_as * own[:, row]
        sd = parameter.shown_as * own_sd[:, row]
        bars = Curve(np.repeat(place, 3), _interrupted(value - sd, value + sd), BEFORE, name="")
        title = f"{parameter.label} [{parameter.unit}]"
        level = parameter.shown_as * float(common[row])
        curves = (bars, Curve(place, value, BEFORE, points=True))
        panels.append(Panel(title, _PLACES, curves, levels=(level,), x_whole=True))
    caption = (
        "The change that the innovations of each dive give on their own, with its formal "
        "standard deviation."
    )
    legend = ((BEFORE, "one dive"), (LIMIT, "all dives"))
    yield Figure("Estimate of each dive alone", caption, tuple(panels), legend)


def _drifts(rows: Sequence[HeldOutRow]) -> Iterator[Figure]:
    drifts_m = np.array(
        [[row.drift_before_m, row.drift_after_m] for row in rows], dtype=np.float64
    ).reshape(-1, 2)
    pairs = drifts_m[np.isfinite(drifts_m).all(axis=1)]
    if len(pairs):
        place = np.arange(1.0, len(pairs) + 1.0)
        bars = Curve(
            np.repeat(place, 3), _interrupted(pairs[:, 0], pairs[:, 1]), REFERENCE, name=""
        )
        ends = [
            Curve(place, pairs[:, i], style, points=True)
            for i, style in enumerate((BEFORE, AFTER))
        ]
        caption = f"Median drift in 60 s without DVL; {counted(len(pairs), 'dive')} had windows."
        panel = Panel("horizontal drift [m]", _PLACES, (bars, *ends), x_whole=True)
        yield Figure("DVL outage test on held-out dives", caption, (panel,), _LEGEND)


def _interrupted(low: Floats, high: Floats) -> Floats:
    """Join lines into one array, with a NaN after each."""
    return np.column_stack([low, high, np.full(len(low), np.nan)]).ravel()
