"""The help of all commands: each in one group, and a word at the wrong place is put right."""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilcell.commands.cli import GROUPS, main, read, whole_parser
from hilcell.commands.parser import build
from hilcell.run.order import Attendance, Order, Resume


def test_every_command_stands_in_one_group_of_the_help() -> None:
    parser = whole_parser()
    assert parser.commands is not None
    grouped = Counter(name for names in GROUPS.values() for name in names)
    assert set(grouped) == set(parser.commands.choices)
    assert set(grouped.values()) == {1}
    text = parser.format_help()
    places = [text.index(f"\n{title}:") for title in GROUPS]
    assert places == sorted(places)
    for title, names in GROUPS.items():
        section = text.partition(f"\n{title}:\n")[2].partition("\n\n")[0]
        assert [line.split()[0] for line in section.splitlines() if line[4] != " "] == [*names]
    assert "exit codes:" in text
    assert "--version" in text


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("--json show last", "`hilcell show .. --json`"),
        ("--runs=x runs", "`hilcell runs .. --runs`"),
        ("--verson", "unknown option --verson"),
        ("--verson", "--version"),
        ("show last --bogus", "unknown option --bogus"),
        ("shwo last", "unknown command 'shwo'"),
        ("show last more", "hilcell show: unexpected argument more"),
        ("show last more", "`hilcell show --help`"),
        ("plant show -x", "hilcell plant show: unknown option -x"),
    ],
)
def test_a_word_at_the_wrong_place_is_named_with_the_right_one(
    words: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """`hilcell --json show last` proposed --version."""
    with pytest.raises(SystemExit) as ended:
        main(words.split())
    assert ended.value.code == 2
    assert said in capsys.readouterr().err


# -- orders as command lines: read again they are the same orders ----------------------------------


# Also names that look like options, and nothing that `clean` would change.
NAMES = st.text("ab-=[/]. ü", min_size=1).filter(
    lambda text: text == text.strip() and text != "--"  # which argparse takes for an end
)
KEYS = st.sampled_from(["a.b", "grid.pitch_mm"])
ORDERS = st.builds(
    Order,
    procedure=st.sampled_from(["calibrate", "home"]),
    cell=NAMES,
    settings=st.lists(st.tuples(KEYS, NAMES), max_size=2).map(tuple),
    seed=st.integers(0, 2**63 - 1),
    machine_seed=st.none() | st.integers(0, 9),
    runs=NAMES.map(Path),
    speed=st.none() | st.just(math.inf) | st.floats(1.0, 1e6),
    attendance=st.builds(Attendance, unattended=st.booleans(), screen=st.booleans()),
    operator=NAMES | st.just(""),
    name=st.none() | st.just("r-1"),
    dry_run=st.booleans(),
    json=st.booleans(),
)


@given(order=ORDERS)
def test_an_order_is_read_from_its_words(order: Order) -> None:
    _, takes, values = read(["run", *order.command_line()])
    values["runs"] = values["runs"] or order.runs
    assert build(takes, values) == order


def test_an_order_says_only_what_differs() -> None:
    order = Order(procedure="home", runs=Path("r"), speed=math.inf, settings=(("a.b", "c"),))
    assert order.command_line() == ["home", "--set=a.b=c", "--runs=r", "--speed=max"]
    resume = Resume(run="last", runs=Path("r"), attendance=Attendance(unattended=True))
    assert resume.command_line() == ["last", "--runs=r", "--unattended"]
