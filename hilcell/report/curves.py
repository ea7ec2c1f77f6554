"""Transmission errors in the report: a table of the swept axes, each curve with its spectrum."""

from __future__ import annotations

from operator import attrgetter
from typing import TYPE_CHECKING

import numpy as np

from hilcell.journal.curve_record import URAD, CurveRecord
from hilcell.report.columns import Column, Sheet, sheet
from hilcell.report.facts import Facts
from hilcell.report.svg import INK, MUTED, axes_sheet

if TYPE_CHECKING:
    from matplotlib.figure import Figure

AXIS_IN = 1.5  # height of one axis's pictures
MEASURED, CURVE = "#8796a5", "#12507b"


def _lines(record: CurveRecord) -> str:
    pairs = zip(record.cycles, record.amplitudes_rad * URAD, strict=True)
    return ", ".join(f"{cycles:.1f}: {size:.1f}" for cycles, size in pairs) or "none"


CURVES: tuple[Column[CurveRecord], ...] = (
    Column("axis", lambda row: f"A{row.axis}"),
    Column("cycles: amplitude", _lines, "µrad"),
    Column("used", lambda row: "yes" if row.holds else f"no: {row.reason}"),
    Column("from", lambda row: float(np.degrees(row.low_rad)), "°", ".1f"),
    Column("to", lambda row: float(np.degrees(row.high_rad)), "°", ".1f"),
    Column("lag", lambda row: row.lag_s * 1e3, "ms", ".2f"),
    Column("lag u", lambda row: row.lag_sigma_s * 1e3, "ms", ".2f"),
    Column("noise", lambda row: row.noise_rad * URAD, "µrad", ".1f"),
    Column("signal", lambda row: 100 * row.share, "%", ".0f"),
    Column("samples lost", attrgetter("lost"), form="d"),
)


def curves(facts: Facts) -> Sheet | None:
    """Return the swept axes with their lines."""
    note = (
        "Found by slow sweeps in both directions: lines in cycles per revolution of the joint. "
        "Lag: how much older the joints' readings are than the tracker's. Noise: of one sample. "
        "Signal: share of the short-wave variance that the lines explain."
    )
    return sheet("Transmission errors", CURVES, facts.log.curves.values(), note)


def fig_curves(facts: Facts) -> tuple[Figure, str] | None:
    """Draw each axis's short-wave error along its sweep, and its spectrum."""
    records = [record for record in facts.log.curves.values() if record.shown]
    if not records:
        return None
    figure, axes = axes_sheet(AXIS_IN * len(records) + 0.5, len(records), 2, width_ratios=(3, 2))
    figure.subplots_adjust(wspace=0.18)
    for (along, across), record in zip(axes, records, strict=True):
        joint, measured, by_curve = np.array(record.shown).T
        along.plot(joint, measured, color=MEASURED, linewidth=0.7, label="measured")
        if record.holds:
            along.plot(joint, by_curve, color=CURVE, linewidth=0.9, label="curve")
        along.set_title(f"A{record.axis}")
        cycles, size = np.array(record.spectrum).T
        across.plot(cycles, size, color=MUTED, linewidth=0.7)
        across.plot(record.cycles, record.amplitudes_rad * URAD, "o", color=INK, markersize=3.0)
        along.set_ylabel("error, µrad")
        across.set_ylim(bottom=0.0)
    along.set_xlabel("joint, °")
    across.set_xlabel("cycles per revolution")
    axes[0, 0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, borderaxespad=0.2)
    return figure, (
        "Left: short-wave error along the sweep, mean of both directions. Right: its amplitudes; "
        "dots are the lines of the curve."
    )
