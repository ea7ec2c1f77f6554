"""One point in words: where it should be, where it is, and how it was measured."""

from __future__ import annotations

from collections.abc import Sequence

from textual.content import Content

from hilcell.journal.log import Point
from hilcell.tui.engine.scene import Scene
from hilcell.tui.text.deviation import rms_mm as rms_of
from hilcell.tui.text.deviation import row_of


def point_page(scene: Scene, key: str) -> Content:
    """Return everything that the journal says of a point."""
    point = scene.log.points.get(key)
    if point is None:
        return Content(f"{key}: the journal holds no such point")
    row = row_of(scene.log, point)
    facts: list[tuple[str, str]] = [("point", key), ("state", row.state)]
    facts += [("group", point.group), ("station", point.station or "-")]
    if row.deviation is not None:
        found = row.deviation
        facts += [
            ("nominal, world {W}, mm", _numbers(point.nominal_mm or (), 3)),
            ("measured, world {W}, mm", _numbers(found.actual_mm, 3)),
            ("e = actual - nominal, mm", _numbers(found.error_mm, 4, sign="+")),
            ("|e|, mm", f"{found.norm_mm:.4f}"),
        ]
        if found.limit_mm is not None:
            facts.append(("limit, mm", f"{found.limit_mm:.3f}"))
    facts += _measured(point)
    return Content("\n").join(
        Content.assemble((f"{name:<28}", "$dim"), text) for name, text in facts
    )


def _measured(point: Point) -> list[tuple[str, str]]:
    facts = [
        ("reading, tracker {L}, mm", _numbers(point.xyz_mm, 4)),
        ("standard deviation, mm", f"{_numbers(point.std_mm, 4)}   rms {rms_of(point):.4f}"),
        ("samples", str(point.samples)),
        ("reflector", point.reflector),
        ("air", _air(point)),
        ("session", str(point.session)),
    ]
    if point.commanded_deg is not None:
        facts.append(("joints commanded, deg", _numbers(point.commanded_deg, 3)))
    if point.joints_deg is not None:
        facts.append(("joints read back, deg", _numbers(point.joints_deg, 3)))
    if point.rail_mm is not None and point.strip_mm is not None:
        facts.append(("rail / strip, mm", f"{point.rail_mm:.3f} / {point.strip_mm:.2f}"))
    return facts


def _air(point: Point) -> str:
    humidity = f"{point.humidity_percent:.0f} %"
    return f"{point.temperature_c:.2f} C  {point.pressure_mbar:.1f} mbar  {humidity}"


def _numbers(values: Sequence[float], digits: int, sign: str = "") -> str:
    return "  ".join(f"{value:{sign}.{digits}f}" for value in values)
