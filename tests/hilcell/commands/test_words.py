"""Orders as command lines: read again they are the same orders."""

from __future__ import annotations

import math
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from hilcell.commands.cli import read
from hilcell.commands.parser import build
from hilcell.run.order import Attendance, Order, Resume

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
