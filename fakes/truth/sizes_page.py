"""The manual's page of a machine's sizes, from its types: ``python -m fakes.truth.sizes_page``."""

from __future__ import annotations

import sys
from typing import get_type_hints

import msgspec

from fakes.truth.machine import load_machine

HEAD = """# Sizes of a simulated machine

The keys of `simulation.sizes` in a cell file, `--set` and the factors of a
[design study](study.md#machines), written by `python -m fakes.truth.sizes_page`. *paper* is the
value of the built-in machine of this name. Lengths and angles that differ from one machine to
another are 1 sigma, drawn by the machine's seed, unless the meaning says how else.
"""
TABLES = ("errors", "transmission", "rail", "mounting", "tracker")
UNITS = {
    "_um_m_k": "µm/(m K)", "_um_m": "µm/m", "_um": "µm", "_mm": "mm", "_urad": "µrad", "_hz": "Hz",
    "_c": "°C", "_k": "K",
}  # fmt: skip


def page() -> str:
    paper = load_machine("paper")
    return "\n".join([HEAD, *(_chapter(table, getattr(paper, table)) for table in TABLES)])


def _chapter(table: str, sizes: msgspec.Struct) -> str:
    kind = type(sizes)
    text = " ".join((kind.__doc__ or "").split()).replace("``", "`")
    rows = [f"## {table}\n\n{text}\n\n| key | unit | paper | meaning |\n|---|---|---|---|"]
    for name, hint in get_type_hints(kind, include_extras=True).items():
        if name in kind.__struct_fields__:
            unit = next((UNITS[end] for end in UNITS if name.endswith(end)), "")
            value = msgspec.json.encode(getattr(sizes, name)).decode()
            rows.append(f"| `{table}.{name}` | {unit} | {value} | {hint.__metadata__[-1]} |")
    return "\n".join([*rows, ""])


if __name__ == "__main__":
    sys.stdout.write(page())
