"""Strict reading: ranges are stated, messages stay short, nothing in a file breaks the reader."""

from __future__ import annotations

from typing import Annotated, Any

import msgspec
import pytest
from msgspec import Meta

from hilcell.cell.file import load_cell
from hilcell.cell.settings import SettingsError, convert, refuse


class Inner(msgspec.Struct, kw_only=True):
    speed: Annotated[float, Meta(gt=0, le=100)] = 1.0
    point: tuple[Annotated[float, Meta(ge=-5, le=5)], float] = (0.0, 0.0)
    word: Annotated[str, Meta(pattern="^a")] = "a"


class Outer(msgspec.Struct, kw_only=True):
    inner: Inner = msgspec.field(default_factory=Inner)
    many: list[Inner] = []
    options: dict[str, Any] = {}

    def __post_init__(self) -> None:
        refuse([f"option {name} is bad" for name in self.options if name.startswith("bad")])


def problems(values: dict[str, object]) -> list[str]:
    with pytest.raises(SettingsError) as error:
        convert(values, Outer, "file.toml")
    return error.value.problems


@pytest.mark.parametrize("value", [0.0, 101.0, -3])
def test_the_allowed_range_is_stated(value: float) -> None:
    (line,) = problems({"inner": {"speed": value}})
    assert line.startswith("inner.speed: ")
    assert "> 0, <= 100" in line


@pytest.mark.parametrize(
    ("values", "path"), [({"inner": 3}, "inner: "), ({"many": [3]}, "many[0]: ")]
)
def test_a_path_ends_without_a_dot(values: dict[str, object], path: str) -> None:
    (line,) = problems(values)
    assert line.startswith(path)


@pytest.mark.parametrize(
    "value",
    ["x" * 10_000, [1] * 10_000, 1 << 100_000, {"a": "b" * 9999}],
    ids=["text", "list", "integer", "table"],
)
def test_huge_values_are_shortened(value: object) -> None:
    for key in ("speed", "word"):
        (line,) = problems({"inner": {key: value}})
        assert len(line) < 300
    (line,) = problems({"inner": value} if not isinstance(value, dict) else {"many": [[value]]})
    assert len(line) < 300


def test_what_is_nested_too_deeply_is_refused() -> None:
    values: dict[str, object] = {}
    for _ in range(100_000):
        values = {"a": values}
    assert len(problems({"inner": {"speed": values}})) == 1


def test_keys_are_shown_without_escape_sequences() -> None:
    (line,) = problems({"\x1b[31mspeed" * 100: 3})
    assert "\x1b" not in line
    assert len(line) < 600


@pytest.mark.parametrize(
    ("key", "text"),
    [
        ("rail.speed_mm_s", "nan"),
        ("rail.travel_max_mm", "inf"),
        ("robot.safe_deg", "[0.0, -90.0, nan, 0.0, 0.0, 0.0]"),
        ("rail.options.any", "nan"),
    ],
)
def test_a_cell_holds_finite_numbers_alone(key: str, text: str) -> None:
    with pytest.raises(SettingsError, match=r"is not a finite number"):
        load_cell("paper", {key: text})
