"""Transmission errors in the report: a table of the swept axes."""

from __future__ import annotations

from operator import attrgetter

import numpy as np

from hilcell.journal.curve_record import URAD, CurveRecord
from hilcell.report.columns import Column, Sheet, sheet
from hilcell.report.facts import Facts


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
