"""Study files for tests."""

from __future__ import annotations

from pathlib import Path

from hilcell.study.study_file import Study, read_study
from tests.whole.bench import SMALL

SETTINGS = "\n".join(f'"{key}" = {value}' for key, value in SMALL.items())
TWO_FACTORS = """
[[factor]]
name = "readings"
setting = "layout.nest_samples"
levels = [2, 5]
costs = [0, 100]

[[factor]]
name = "place"
setting = "grid.centre.x_mm"
levels = [1850.0, 3850.0]
labels = ["near", "far"]
"""


def written(
    folder: Path, factors: str = TWO_FACTORS, head: str = "machines = 2", name: str = "study.toml"
) -> Path:
    path = folder / name
    path.write_text(f'name = "trial"\n{head}\n\n[settings]\n{SETTINGS}\n{factors}')
    return path


def study(folder: Path, factors: str = TWO_FACTORS, head: str = "machines = 2") -> Study:
    return read_study(written(folder, factors, head))
