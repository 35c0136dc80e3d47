"""A calibration for people."""

from collections.abc import Iterator, Sequence

from insdvl_replay.calibration.calibration import AXES, Calibration
from insdvl_replay.calibration.parameters import LABELS
from insdvl_replay.calibration.rows import DiveRow, HeldOutRow, NoiseRow, ParameterRow, ReferenceDiveRow, StartRow
from insdvl_replay.core.words import Estimated
from insdvl_replay.report.document import (
    Callout,
    DisplayTable,
    Heading,
    Part,
    Remark,
    Sentences,
    Title,
    counted,
    number,
    table_of,
)
from insdvl_replay.report.plots.panel import Figure


def calibration_document(found: Calibration, written: str = "", figures: Sequence[Figure] = ()) -> list[Part]:
    """Lay out a calibration: what is proposed first, then what it rests on, and what speaks against it."""
    parts: list[Part] = [
        Title(f"Calibration of the DVL from {counted(len(found.dives), 'dive')}"),
        Callout(_headline(found), "good" if found.estimated and not found.doubts else "bad"),
        _parameters("Change from what the configuration says; x forward, y starboard, z down", found.rows),
        _noise(found.noise_rows),
        _dives(found.dives),
    ]
    if found.tried:
        parts.insert(2, f"The mounting was not known: {found.tried}.")
    if found.reference is not None:
        parts += [_parameters("The reference: change from what the configuration says", found.reference.rows)]
        parts += [_beside(found.reference.dives)]
        if found.reference.starts:
            parts.append(_starts(found.reference.starts))
    if found.held_out:
        parts.append(_held_out(found.held_out))
    if reasons := [*_reasons(found), *(Remark(doubt) for doubt in found.doubts)]:
        parts.append(Sentences(tuple(reasons)))
    parts += _what_now(found, written)
    return [*parts, Heading("Pictures"), *figures] if figures else parts


def _headline(found: Calibration) -> str:
    if not found.estimated and not found.proposes_noise:
        return "Nothing could be estimated: these dives hold no manoeuvre that would show it."
    names = [*_named(found, Estimated.ESTIMATED), *(["noise"] if found.proposes_noise else [])]
    return f"Estimated: {', '.join(names)}."


def _named(found: Calibration, status: Estimated) -> list[str]:
    return [LABELS[row.parameter] for row in found.all_rows if row.status == status]


def _reasons(found: Calibration) -> Iterator[Remark]:
    """State why parameters are not proposed, those with the same reason together."""
    for status, said in ((Estimated.HELD, "held"), (Estimated.DOUBTFUL, "not proposed")):
        rows = [row for row in found.all_rows if row.status == status]
        for why in dict.fromkeys(row.why for row in rows):
            names = ", ".join(LABELS[row.parameter] for row in rows if row.why == why)
            yield Remark(f"{names}: {said}; {why}")
    for why in dict.fromkeys(
        row.why for row in found.noise_rows if row.status in (Estimated.HELD, Estimated.NOT_DETERMINED)
    ):
        names = ", ".join(row.parameter for row in found.noise_rows if row.why == why)
        yield Remark(f"{names}: {why}")


def _what_now(found: Calibration, written: str) -> Iterator[Part]:
    if written and (found.estimated or found.proposes_noise):
        yield f"Nothing is applied by itself: `insdvl-replay run LOG -c ... -c {written}` uses it."


def _parameters(title: str, rows: tuple[ParameterRow, ...]) -> DisplayTable:
    return table_of(
        title,
        [row for row in rows if row.status != Estimated.NOT_ASKED],
        (
            ("parameter", "l", lambda row: f"{LABELS[row.parameter]} [{row.unit}]"),
            ("change", "r", _change),
            ("sd", "r", lambda row: number(row.sd)),
            ("formal", "r", lambda row: number(row.formal_sd)),
            ("corre-\nlated", "r", lambda row: number(row.correlated_sd)),
            ("between\ndives", "r", lambda row: number(row.between_dives_sd)),
            ("signal /\nnoise", "r", lambda row: number(row.signal_to_noise)),
        ),
        "The sd is the largest of the three, with what beams (each 0.2 % and 1 mm/s) and the IMU (1500 ppm and "
        "1 mrad) may be off by. What is below a signal to noise of 3 (mounting: 4, scale: 30) is held.",
    )


def _change(row: ParameterRow) -> str:
    if row.status == Estimated.HELD or row.change is None:
        return Estimated.HELD
    sign, doubt = "-" if row.change < 0.0 else "+", "?" if row.status == Estimated.DOUBTFUL else ""
    return f"{sign}{number(abs(row.change))}{doubt}"


def _noise(rows: tuple[NoiseRow, ...]) -> DisplayTable:
    return table_of(
        "White noise under which the innovations are likeliest",
        rows,
        (
            ("noise", "l", lambda row: f"{row.parameter} [{row.unit}]"),
            ("before", "r", lambda row: number(row.before)),
            ("after", "r", _noise_after),
            ("sd", "r", lambda row: number(row.sd)),
            ("class", "l", lambda row: row.sensor_class),
        ),
        "" if all(row.status != Estimated.NOT_ASKED for row in rows) else "It was not asked for, and only weighs.",
    )


def _noise_after(row: NoiseRow) -> str:
    if row.status == Estimated.NOT_DETERMINED:
        return f"not determined{f', at most {number(row.after)}' if row.is_proposed else ''}"
    return number(row.after) if row.status in (Estimated.ESTIMATED, Estimated.NOT_ASKED) else Estimated.HELD


def _dives(rows: tuple[DiveRow, ...]) -> DisplayTable:
    def axes(values: tuple[float, float, float]) -> str:
        return " ".join(f"{value:.2f}" for value in values)

    return table_of(
        f"Innovations in standard deviations of the noise that was fitted, {', '.join(AXES)}",
        rows,
        (
            ("dive", "l", lambda row: row.dive),
            ("pings", "r", lambda row: str(row.pings)),
            ("left\nout", "r", lambda row: str(row.left_out)),
            ("delay\n[s]", "r", lambda row: number(row.delay_s)),
            ("before", "r", lambda row: axes(row.before)),
            ("after", "r", lambda row: axes(row.after)),
            ("alike", "r", lambda row: axes(row.autocorrelation)),
        ),
        "1 is what a filter expects that knows its noise; neighbours are alike by 0 where nothing is left to find.",
    )


def _beside(rows: tuple[ReferenceDiveRow, ...]) -> DisplayTable:
    return table_of(
        "Beside the reference, before and after: what velocities, or ways of 10 s, differ by, and the track",
        rows,
        (
            ("dive", "l", lambda row: row.dive),
            ("rows", "r", lambda row: str(row.rows)),
            ("rms before", "r", lambda row: f"{number(row.rms_before)} {row.unit}"),
            ("after", "r", lambda row: f"{number(row.rms_after)} {row.unit}"),
            ("scale before\n[%]", "r", lambda row: number(row.track_scale_before_pct)),
            ("after\n[%]", "r", lambda row: number(row.track_scale_after_pct)),
            ("turn before\n[deg]", "r", lambda row: number(row.track_turn_before_deg)),
            ("after\n[deg]", "r", lambda row: number(row.track_turn_after_deg)),
        ),
        "Scale and turn would lay the filter's track on the reference's; the turn holds what the heading drifted by.",
    )


def _starts(rows: tuple[StartRow, ...]) -> DisplayTable:
    return table_of(
        "Starts by the tracks of positions, with the DVL as it is proposed",
        rows,
        (
            ("dive", "l", lambda row: row.dive),
            ("heading\n[deg]", "r", lambda row: number(row.heading_deg)),
            ("sd", "r", lambda row: number(row.heading_sd_deg)),
            ("gyro bias\n[deg/h]", "r", lambda row: number(row.gyro_bias_degph)),
            ("sd", "r", lambda row: number(row.gyro_bias_sd_degph)),
        ),
        'initial.heading_deg = "fit" finds them anew for each dive.',
    )


def _held_out(rows: tuple[HeldOutRow, ...]) -> DisplayTable:
    return table_of(
        "Dives that were not fitted: NIS / dof, and drift in 60 s without velocities",
        rows,
        (
            ("dive", "l", lambda row: row.dive),
            ("NIS before", "r", lambda row: number(row.nis_per_dof_before)),
            ("after", "r", lambda row: number(row.nis_per_dof_after)),
            ("with\nnoise", "r", lambda row: number(row.nis_per_dof_noise)),
            ("windows", "r", lambda row: str(row.windows)),
            ("drift before\n[m]", "r", lambda row: number(row.drift_before_m)),
            ("after\n[m]", "r", lambda row: number(row.drift_after_m)),
        ),
    )
