"""Transmission errors drawn: a row for each axis, its curve at the left, its spectrum right."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hilcell.model.events import CurveMeasured
from hilcell.report.drawings.drawing import (
    AFTER,
    ENDS,
    HATCH,
    INK,
    Frame,
    Scale,
    circle,
    path,
    round_up,
    svg,
    text,
)
from hilcell.report.facts import Facts

WIDTH_MM, ROW_MM, HIGH_MM, TOP_MM = 178.0, 44.0, 26.0, 8.0
CURVE_MM, SPECTRUM_MM = (12.0, 108.0), (122.0, 176.0)
LABEL_MM = 17.0  # the widest


def curve_plots(facts: Facts) -> str:
    """Return a drawing of each swept axis, between which a page may end; "" without any."""
    records = [record for record in facts.log.curves.values() if record.shown]
    if not records:
        return ""
    most = max(float(np.array(record.spectrum)[:, 1].max()) for record in records)
    high_urad, simulated = round_up(most, ENDS), facts.inputs.simulated
    title = "Transmission error of a gear, and its spectrum"
    return "".join(
        svg(WIDTH_MM, ROW_MM, f"{title}, axis {each.axis}", _row(each, high_urad), simulated)
        for each in records
    )


def _row(record: CurveMeasured, most_urad: float) -> Iterator[str]:
    high, low = TOP_MM, TOP_MM + HIGH_MM
    joint_deg, measured_urad, by_curve_urad = np.array(record.shown).T
    size = round_up(float(np.abs(measured_urad).max()))
    frame = Frame(
        Scale(float(joint_deg.min()), float(joint_deg.max()), *CURVE_MM),
        Scale(-size, size, low, high),
    )
    yield frame.drawn("joint, °", f"A{record.axis}: error, µrad")
    yield path(frame.at(joint_deg, measured_urad), HATCH, 0.3)
    if record.holds:
        yield path(frame.at(joint_deg, by_curve_urad), AFTER, 0.4)
    else:
        yield text(CURVE_MM[1], high - 1.0, f"not used: {record.reason}", "end")
    cycles, amplitude_urad = np.array(record.spectrum).T
    across = Frame(
        Scale(max(10.0, float(cycles.min())), float(cycles.max()), *SPECTRUM_MM, logarithmic=True),
        Scale(0.0, most_urad, low, high),
    )
    yield across.drawn("cycles per revolution (logarithmic)", "")
    yield path(across.at(cycles, amplitude_urad), INK, 0.3)
    for at, amplitude in zip(record.cycles, record.amplitudes_urad, strict=True):
        x, y = across.x.one(at), across.y.one(float(amplitude))
        yield circle(x, y, 0.8, AFTER, AFTER)
        left_mm, right_mm = SPECTRUM_MM[0], WIDTH_MM
        yield text(
            min(max(x, left_mm + LABEL_MM / 2), right_mm - LABEL_MM / 2),
            y - 1.4,
            f"{at:.1f}: {amplitude:.0f}",
            "middle",
            AFTER,
            bold=True,
        )
