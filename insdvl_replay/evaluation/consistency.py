"""Whether a filter's innovations are as large as it says: the mean NIS, its chi-square interval, and each axis.

Source: Bar-Shalom, Li and Kirubarajan, "Estimation with Applications to Tracking and Navigation", chapter 5.
"""

from collections.abc import Iterator

import numpy as np
import pandas as pd

from insdvl_replay.core.columns import NS_PER_S, Floats
from insdvl_replay.core.errors import Note
from insdvl_replay.core.history import History, Innovations
from insdvl_replay.core.result_tables import AXES, axis_of
from insdvl_replay.evaluation.chi_square import mean_interval, verdict
from insdvl_replay.evaluation.whiteness import autocorrelation, whiteness

FEWEST_UPDATES = 10
"""With fewer updates the verdict is ``too few``."""
MANY_REJECTED = 0.1
"""A gate that rejects a larger share does not keep outliers out but the DVL."""


def consistency_table(log: str, histories: tuple[History, ...]) -> pd.DataFrame:
    """Judge each filter's innovations, measurement by measurement and axis by axis.

    Parameters
    ----------
    log : str
        Name of the dive.
    histories : tuple of History
        All filters; the baseline has rows of its own.

    Returns
    -------
    DataFrame
        Columns log, filter, measurement, dof, used, rejected, mean_nis, low, high, verdict (``consistent``,
        ``over-confident``, ``over-cautious``, ``too few``, ``not finite``), autocorrelation (with the innovation
        before), autocorrelation_limit, whiteness (``white``, ``correlated``, ``too few``, ``not finite``). NIS is that
        of all innovations; what the gate rejected counts as much as the gate is, see `history.Innovations.weight`.
        Whiteness is that of the innovations that were used. After the row of a whole measurement, such as ``velocity``,
        stand those of its axes in b, ``velocity_x`` to ``velocity_z``, where NIS is ``z_i^2 / S_ii``.
    """
    rows = [
        (log, history.filter, *row)
        for history in histories
        for innovations in history.innovations
        for row in _rows(innovations)
    ]
    names = [
        "log", "filter", "measurement", "dof", "used", "rejected", "mean_nis", "low", "high", "verdict",
        "autocorrelation", "autocorrelation_limit", "whiteness",
    ]  # fmt: skip
    return pd.DataFrame(rows, columns=names)


def _rows(innovations: Innovations) -> Iterator[tuple[str | int | float, ...]]:
    """Give the row of a whole measurement, then those of its axes, without log and filter."""
    standardised, rejected = innovations.standardised_b, rejections(innovations)
    whole = (innovations.measurement, innovations.dof, innovations.nis, standardised)
    axes = (
        (axis_of(innovations.measurement, axis), 1, standardised[:, i] ** 2, standardised[:, i : i + 1])
        for i, axis in enumerate(AXES)
    )
    for name, dof, nis, components in (whole, *axes):
        correlation = autocorrelation(components, innovations.used)
        counts = int(innovations.used.sum()), rejected
        yield name, dof, *counts, *_judged(nis * innovations.weight, dof), *correlation, whiteness(*correlation)


def _judged(nis: Floats, dof: int) -> tuple[float, float, float, str]:
    if len(nis) < FEWEST_UPDATES:
        nan = float("nan")
        return nan, nan, nan, "too few"
    mean_nis = float(nis.mean())
    low, high = mean_interval(dof, len(nis))
    return mean_nis, low, high, verdict(mean_nis, low, high, dof)


def log_likelihood(innovations: Innovations) -> float:
    """Give the logarithm of the probability density of all innovations under the filter that met them.

    Innovations of a filter that is right are independent and normal, so that it is the sum of
    ``-(ln det S + z' S^-1 z + d ln 2 pi) / 2``. Gated innovations count: leaving them out would reward a filter that
    rejects what it does not like.

    Parameters
    ----------
    innovations : Innovations

    Returns
    -------
    float
        Minus infinity where an innovation is not finite.
    """
    constant = innovations.dof * np.log(2.0 * np.pi)
    total = -0.5 * float(np.sum(innovations.log_det + innovations.nis + constant))
    return total if np.isfinite(total) else float("-inf")


def update_notes(histories: tuple[History, ...]) -> tuple[Note, ...]:
    """Warn of filters whose aiding did not happen as configured: their tables say less than they seem to.

    Parameters
    ----------
    histories : tuple of History

    Returns
    -------
    tuple of Note
        Aiding without any update, innovations that are not finite, and gates that reject more than outliers.
    """
    notes = []
    for history in histories:
        for innovations in history.innovations:
            notes += _judged_updates(history.filter, innovations)
    return tuple(notes)


def _judged_updates(name: str, innovations: Innovations) -> list[Note]:
    kind, total = innovations.measurement, len(innovations.used)
    if total == 0:
        text, hint = f"filter {name} had no {kind} to use", f"filters.{name}.acceleration.max_window_gap_s or window"
        return [Note("aiding_without_updates", text, 0, "warning", hint)]
    lost = int(np.sum(~np.isfinite(innovations.nis)))
    if lost:
        first = int(np.argmax(~np.isfinite(innovations.nis)))
        text = (
            f"filter {name} broke down: {lost} of {total} {kind} innovations are not finite, from number {first + 1} on"
        )
        hint = 'check the units and sizes of [noise] and [initial]; after long IMU gaps, imu.long_gaps = "split"'
        return [Note("filter_not_finite", text, lost, "warning", hint)]
    hint = f"check lever arm and mounting, raise [noise], or --set filters.{name}.gate_probability=1.0"
    return [*_rejection_notes(name, innovations, hint), *_reopening_notes(name, innovations, hint)]


def _rejection_notes(name: str, innovations: Innovations, hint: str) -> list[Note]:
    rejected, total = rejections(innovations), len(innovations.used)
    if rejected <= MANY_REJECTED * total:
        return []
    text = f"filter {name} rejected {rejected} of {total} {innovations.measurement} innovations"
    return [Note("gate_rejects_many", text, rejected, "warning", hint)]


def _reopening_notes(name: str, innovations: Innovations, hint: str) -> list[Note]:
    reopened = np.flatnonzero(innovations.reopened)
    if not len(reopened):
        return []
    first_s = (innovations.time_ns[reopened[0]] - innovations.time_ns[0]) / NS_PER_S
    text = (
        f"filter {name} was set to the DVL again after runs of rejected velocities ({len(reopened)} in all, the first "
        f"{first_s:.1f} s after the first ping)"
    )
    return [Note("gate_reopened", text, len(reopened), "warning", hint)]


def rejections(innovations: Innovations) -> int:
    """Count the innovations that the gate rejected."""
    return int(np.sum(~innovations.used & np.isfinite(innovations.nis)))
