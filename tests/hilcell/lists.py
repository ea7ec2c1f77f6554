"""Lists of targets as tests write them."""

from collections.abc import Iterable
from pathlib import Path

from hilcell.compensation.targets import HEADER, Stamp, target_rows, write_rows
from hilcell.ports import Array


def write_targets(
    path: Path,
    names: list[str],
    values: Array,
    *,
    stamp: Stamp | None = None,
    inputs: Iterable[Path] = (),
) -> None:
    """Write targets (N, 6), corrected ones with their stamp."""
    write_rows(path, HEADER, target_rows(names, values), stamp=stamp, inputs=inputs)
