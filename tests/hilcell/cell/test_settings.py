"""Strict reading: ranges are stated, messages stay short, nothing in a file breaks the reader."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Annotated, Any

import msgspec
import pytest
from msgspec import Meta

from hilcell.cell.file import Cell, load_cell
from hilcell.cell.settings import SettingsError, convert, did_you_mean, refuse


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


@pytest.mark.parametrize(
    ("values", "path", "part"),
    [
        ({"inner": {"speed": 0.0}}, "inner.speed: ", "> 0, <= 100"),
        ({"inner": {"speed": 101.0}}, "inner.speed: ", "> 0, <= 100"),
        ({"inner": {"speed": -3}}, "inner.speed: ", "> 0, <= 100"),
        ({"inner": 3}, "inner: ", ""),  # without a dot
        ({"many": [3]}, "many[0]: ", ""),
        ({"\x1b[31mspeed" * 100: 3}, "", "unknown key"),
    ],
)
def test_a_problem_has_its_path_and_the_allowed_range(
    values: dict[str, object], path: str, part: str
) -> None:
    (line,) = problems(values)
    assert line.startswith(path)
    assert part in line
    assert "\x1b" not in line
    assert len(line) < 600


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


@pytest.mark.parametrize(
    ("word", "known", "meant"),
    [
        ("rial", ["rail", "tracker"], "rail"),
        ("calbirate", ["calibrate", "recheck"], "calibrate"),
        ("--jsn", ["--json", "--set"], "--json"),
        ("rail_1O", ["rail_61", "rail_71", "rail_10"], "rail_10"),
        ("nosuch", ["touch", "calibrate"], ""),
        ("--bogus", ["--runs", "--bounds"], ""),
        ("rail.interface", ["rail", "tracker"], ""),
    ],
)
def test_only_a_near_miss_is_offered(word: str, known: list[str], meant: str) -> None:
    assert did_you_mean(word, known) == (f'; did you mean "{meant}"?' if meant else "")


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


class Checked(msgspec.Struct, kw_only=True):
    low: float
    high: float = 2.0
    inner: Inner = msgspec.field(default_factory=Inner)
    many: list[Inner] = []

    MOST = 10.0

    def __post_init__(self) -> None:
        refuse(line for check in self.checks() for line in check())

    def checks(self) -> Sequence[Callable[[], Iterable[str]]]:
        return (
            lambda: ["low: above high"] if not self.low < self.high else [],
            lambda: [] if self.width < self.MOST else ["too wide"],
            lambda: [
                f"{each.speed:g} is that of inner" for each in self.many if self.is_like(each)
            ],
        )

    @property
    def width(self) -> float:
        return self.high - self.low

    def is_like(self, other: Inner) -> bool:
        return self.inner.speed == other.speed


@pytest.mark.parametrize(
    ("values", "found"),
    [
        ({"low": "x", "high": "y"}, ["low", "high"]),
        ({"low": 3.0, "inner": 3}, ["inner", "low"]),
        ({"low": "x", "many": [{}]}, ["low", "file"]),
        ({"low": -20.0, "many": [3]}, ["many[0]", "file"]),
        ({"low": 1.0, "many": [{"speed": "x"}, {}]}, ["many[0].speed"]),
        ({"many": [{"speed": 5.0}, {}]}, ["low", "file"]),
        ({"low": -20.0, "unknown": 1}, ["unknown", "file"]),
    ],
)
def test_a_check_is_left_out_only_where_it_reads_a_field_with_a_problem(
    values: dict[str, object], found: list[str]
) -> None:
    with pytest.raises(SettingsError) as error:
        convert(values, Checked, "file.toml")
    assert [line.split(": ")[0] for line in error.value.problems] == found


BROKEN: dict[str, Callable[[Any], Iterable[str]]] = {
    "a field that there is not": lambda table: [table.hihg],
    "a field of another table": lambda table: [table.inner.hihg],
    "a field of a list's tables": lambda table: [each.hihg for each in table.many],
    "a value that has no such attribute": lambda table: [table.high.mean],
}


@pytest.mark.parametrize("check", BROKEN.values(), ids=list(BROKEN))
@pytest.mark.parametrize("values", [{}, {"low": "x"}, {"inner": {"speed": 0.0}}, {"no": 1}])
def test_a_typo_in_a_check_is_never_skipped(
    check: Callable[[Any], Iterable[str]],
    values: dict[str, object],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Checked, "checks", lambda table: (lambda: check(table),))
    with pytest.raises(AttributeError, match=r"hihg|mean"):
        convert({"low": 1.0, "many": [{}]} | values, Checked, "file.toml")


def test_a_type_error_in_a_check_is_never_taken_for_a_problem(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Checked, "checks", lambda table: (lambda: [str(table.high + "mm")],))
    for values in ({"low": 1.0}, {"low": "x"}):
        with pytest.raises(TypeError):
            convert(values, Checked, "file.toml")


@pytest.mark.parametrize("name", [*vars(Cell)["__annotations__"]])
def test_each_typo_of_the_cell_s_own_checks_fails_though_any_table_is_unread(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def with_typo(cell: Any) -> list[str]:
        return [str(cell.gird)]

    checks = ["_bad_names", "_bad_grid_station", "_bad_fixed", "_bad_others", "_bad_survey"]
    with pytest.raises(SettingsError, match=name):  # and nothing else: all checks can do without
        load_cell("paper", {name: "3"})
    for check in checks:
        with monkeypatch.context() as patched:
            patched.setattr(Cell, check, with_typo)
            with pytest.raises(AttributeError, match="gird"):
                load_cell("paper", {name: "3"})


def test_the_check_of_a_sound_table_sees_the_table_itself() -> None:
    """A driver's Options may use all that msgspec offers there."""

    class Half(msgspec.Struct):
        whole: int
        half: float = 0.0

        def __post_init__(self) -> None:
            msgspec.structs.force_setattr(self, "half", self.whole / 2)

    assert convert({"whole": 3}, Half, "file.toml") == Half(3, 1.5)
