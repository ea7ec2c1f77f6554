"""An order is refused or planned before anything is opened; an engine holds the cell's lock."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest

from hilcell.cell.settings import SettingsError
from hilcell.errors import HilcellError
from hilcell.journal.journal import Record, read_journal
from hilcell.journal.runs import JOURNAL, read_log
from hilcell.run.cell_lock import CellLocked
from hilcell.run.engine import Ending, Engine, NewEngine, ResumedEngine
from hilcell.run.order import Attendance, Order, Resume

ALONE = Attendance(unattended=True)


class Heard:
    """An output that keeps what it is given."""

    def __init__(self) -> None:
        self.kinds, self.measured, self.entered = list[str](), list[str](), 0

    def __enter__(self) -> None:
        self.entered += 1

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        self.entered -= 1

    def take(self, record: Record) -> None:
        self.kinds.append(record.kind)

    def skip_measured(self, keys: Iterable[str]) -> None:
        self.measured = list(keys)


def home(runs: Path, **more: Any) -> Order:
    order = Order(procedure="home", runs=runs, name="R", attendance=ALONE)
    return order.replace(**more)


@pytest.mark.parametrize(
    ("more", "code"),
    [
        ({"settings": (("simulation.address", "127.0.0.1:9"),), "speed": 2.0}, "HC-C17"),
        ({"settings": (("simulation.address", "127.0.0.1:9"),), "machine_seed": 2}, "HC-C17"),
        ({"settings": (("layout.reflectors", "by_hand"),)}, "HC-C16"),
        ({"procedure": "reflectors"}, "HC-C16"),
    ],
)
def test_an_order_is_refused_before_anything_is_opened(
    tmp_path: Path, more: dict[str, Any], code: str
) -> None:
    with pytest.raises(HilcellError) as refused:
        home(tmp_path, **more).check(print)
    assert refused.value.code == code
    assert list(tmp_path.iterdir()) == []


def test_what_somebody_does_by_hand_is_never_left_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It neither begins unattended nor goes on so."""
    words = (
        "reflectors refused before anything moves: an operator must carry each reflector "
        "to the first floor nest; leave out --unattended"
    )
    attended = Order(procedure="reflectors", runs=tmp_path, name="R")
    with pytest.raises(HilcellError) as refused:
        attended.replace(attendance=ALONE).check(print)
    assert (refused.value.code, str(refused.value)) == ("HC-C16", words)
    monkeypatch.setattr(Engine, "_perform", lambda *given: Ending(4, None))
    with NewEngine(attended, attended.check(print), print) as engine:
        engine.run(Heard())
    folder, again = tmp_path / "R", Resume(run="R", runs=tmp_path)
    assert again.check(folder, read_log(folder), operator_present=True).continues
    with pytest.raises(HilcellError) as refused:
        again.replace(attendance=ALONE).check(folder, read_log(folder), operator_present=False)
    assert (refused.value.code, str(refused.value)) == ("HC-C16", words)


def test_settings_are_refused_with_their_place(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="nowhere"):
        home(tmp_path, settings=(("nowhere.key", "1"),)).check(print)


def test_a_plan_states_the_machine_and_opens_nothing(tmp_path: Path) -> None:
    plan = home(tmp_path, seed=4).check(print)
    assert (plan.folder, plan.machine_seed, plan.points) == (tmp_path / "R", 4, 0)
    assert home(tmp_path, seed=4, machine_seed=7).check(print).machine_seed == 7
    assert "home" in home(tmp_path, name=None, dry_run=True).check(print).folder.name
    assert list(tmp_path.iterdir()) == []


def test_an_engine_performs_an_order_and_holds_its_lock_alone(tmp_path: Path) -> None:
    order, heard = home(tmp_path), Heard()
    with NewEngine(order, order.check(print), print) as engine:
        other = home(tmp_path, name="S")
        with pytest.raises(CellLocked), NewEngine(other, other.check(print), print):
            pass
        ending = engine.run(heard)
    assert (ending.code, ending.fault, heard.entered) == (0, None, 0)
    assert (heard.kinds[0], heard.kinds[-1]) == ("plan", "end")
    assert [each.name for each in tmp_path.iterdir() if each.is_dir()] == ["R"]
    with pytest.raises(HilcellError) as refused, NewEngine(order, order.check(print), print):
        pass
    assert refused.value.code == "HC-J09"
    with pytest.raises(HilcellError) as over:
        Resume(run="R", runs=tmp_path).check(
            tmp_path / "R", read_log(tmp_path / "R"), operator_present=True
        )
    assert over.value.code == "HC-J09"


def test_a_run_whose_device_is_locked_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def busy(self: Engine, noted: object) -> Ending:
        raise CellLocked("rail")

    monkeypatch.setattr(Engine, "_perform", busy)
    order = home(tmp_path)
    with pytest.raises(CellLocked), NewEngine(order, order.check(print), print) as engine:
        engine.run(Heard())
    assert not (tmp_path / "R").exists()


def test_a_resumed_run_journals_the_agreement_and_its_order(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Engine, "_perform", lambda *given: Ending(4, None))
    order = home(tmp_path)
    with NewEngine(order, order.check(print), print) as engine:
        engine.run(Heard())
    monkeypatch.setattr("hilcell.run.run_plan.__version__", "0.0")
    folder, again = tmp_path / "R", Resume(run="R", runs=tmp_path)
    plan = again.check(folder, read_log(folder), operator_present=True)
    assert (plan.continues, len(plan.changes.inputs)) == (True, 1)
    with ResumedEngine(again, plan, print) as resumed:
        resumed.agree()
        assert resumed.plan.changes.inputs == ()
        resumed.run(Heard())
    events = [each.body["what"] for each in read_journal(folder / JOURNAL) if each.kind == "event"]
    assert events == ["changes accepted", "order"]
    with pytest.raises(HilcellError) as refused:
        again.check(folder, read_log(folder), operator_present=False)
    assert refused.value.code == "HC-C30"
