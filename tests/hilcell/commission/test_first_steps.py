"""The first step: devices are listed before an address is asked for; impossible options refused."""

from collections.abc import Mapping
from pathlib import Path
from queue import Queue

import msgspec
import pytest

from hilcell.cell.layout import Nest
from hilcell.cell.settings import SettingsError
from hilcell.cell.tables import UNPLACED_MM
from hilcell.commission.cell_text import CellText
from hilcell.commission.dialogue import TypedDialogue
from hilcell.commission.draft import write_floor_robot
from hilcell.commission.first_steps import (
    WhichDevices,
    drawing,
    nest_count,
    one_of,
    radii,
    real_or_address,
    real_or_hall,
    taught_names,
    volume_list,
)
from hilcell.commission.sequence import steps_of
from hilcell.errors import HilcellError
from hilcell.ports import Candidate, Identity

KNOWN = Identity("Rail", "drive", "7", "can0", False, "drive")
LINE = Candidate("serial line usb-1, not opened", {"channel": "/dev/usb-1"}, [])
OPENED = Candidate("usb-1: drive", {"channel": "/dev/usb-1", "drive_node": 3}, [KNOWN])
BUS = Candidate("can0: drive", {"channel": "can0", "drive_node": 5}, [KNOWN])


def rail(listed: list[Candidate], by_channel: Mapping[str, Candidate]) -> type:
    """Return a driver's class that lists these, and finds a device at each of the channels."""

    class Rail:
        class Options(msgspec.Struct):
            channel: str = ""

        @classmethod
        def discover(cls, known: Mapping[str, object]) -> list[Candidate]:
            if not known:
                return listed
            found = by_channel.get(str(known["channel"]))
            return [] if found is None else [found]

    return Rail


@pytest.mark.parametrize("answer", ["banana", "", "1.2.3.4", ":29543", "host:"])
def test_a_hall_s_address_is_asked_for_again(answer: str) -> None:
    with pytest.raises(ValueError, match="expected real, or HOST:PORT, got"):
        real_or_address(answer)
    assert real_or_address("real") == "real"
    assert real_or_address("127.0.0.1:29543") == "127.0.0.1:29543"


BUSES = {"can0": BUS, "/dev/usb-1": OPENED}


@pytest.mark.parametrize(
    ("listed", "typed", "node", "questions"),
    [
        ([BUS], [], 5, 0),
        ([LINE], ["1"], 3, 1),
        ([BUS, LINE], ["2"], 3, 1),
        ([BUS, LINE], ["other", "can0"], 5, 2),
        ([], ["can0"], 5, 1),
    ],
)
def test_an_address_is_asked_for_only_where_none_is_listed(
    listed: list[Candidate], typed: list[str], node: int, questions: int
) -> None:
    lines: Queue[str | None] = Queue()
    for line in [*typed, None]:
        lines.put(line)
    dialogue = TypedDialogue(lines, lambda _: None)
    work = WhichDevices(Path("hall.toml"), CellText(), dialogue)
    found = work.found("rail", rail(listed, BUSES), {})
    assert found.options["drive_node"] == node
    assert dialogue.questions == questions


@pytest.mark.parametrize(
    ("driver", "model", "typed", "name", "questions"),
    [
        ("kuka-eki", "#KR120R2700_2 C4 FLR", [], "KR 120 R2700-2", 0),
        ("kuka-c3", "#KR150R2700 EXTRA C4 FLR", ["KR 210 R2700 extra"], "KR 210 R2700 extra", 1),
        ("kuka-c3", "#KR150R2700 EXTRA C4 FLR", ["UR5", "9"], "KR 70 R2100", 1),
        ("ur-rtde", None, ["UR5e"], "UR5e", 1),
        ("abb-egm", "IRB 6700-235/2.65", [], "IRB 6700-235/2.65", 0),
    ],
)
def test_the_kinematics_are_asked_for_only_where_the_controller_states_another_robot(
    driver: str, model: str | None, typed: list[str], name: str, questions: int
) -> None:
    lines: Queue[str | None] = Queue()
    for line in [*typed, None]:
        lines.put(line)
    text, dialogue = CellText(), TypedDialogue(lines, lambda _: None)
    text.set("robot.driver", driver)
    stated = [] if model is None else [Identity("Robot", model, "7", "host", False, "robot")]
    WhichDevices(Path("hall.toml"), text, dialogue).kinematics(stated)
    assert text.get("robot.name") == name
    assert text.get("robot.speed_percent") == 10.0
    assert dialogue.questions == questions


def test_a_maker_whose_robots_are_not_known_needs_rows_in_the_file() -> None:
    text = CellText()
    text.set("robot.driver", "another-maker")
    work = WhichDevices(Path("hall.toml"), text, TypedDialogue(Queue(), lambda _: None))
    with pytest.raises(HilcellError, match=r"write \[\[robot.joint\]\] into hall.toml"):
        work.kinematics([])
    text.set("robot.joint", [{"a_mm": 0.0}])
    work.kinematics([])


def test_an_address_where_nothing_answers_is_asked_for_again() -> None:
    lines, said = Queue[str | None](), list[str]()
    for line in ("can1", "can0"):
        lines.put(line)
    work = WhichDevices(Path("hall.toml"), CellText(), TypedDialogue(lines, said.append))
    assert work.found("rail", rail([], BUSES), {}) == BUS
    assert [each for each in said if "no device answers at channel can1; check" in each]


def test_a_hall_that_does_not_run_is_asked_for_again() -> None:
    with pytest.raises(ValueError, match=r"127\.0\.0\.1:9"):
        real_or_hall("127.0.0.1:9")
    assert real_or_hall("real") == "real"


def test_a_reflector_is_one_that_the_tracker_knows() -> None:
    with pytest.raises(ValueError, match=r"one of SMR 0\.5in, SMR 1\.5in, got 'foo'"):
        one_of(["SMR 0.5in", "SMR 1.5in"])("foo")
    assert one_of(["SMR 1.5in"])("SMR 1.5in") == "SMR 1.5in"
    assert one_of([])("foo") == "foo"  # the tracker does not tell them
    with pytest.raises(ValueError, match="expected a name"):
        one_of([])("")


@pytest.mark.parametrize(
    ("driver", "option"),
    [("kuka-c3", "port = 70000"), ("kuka-eki", 'port = "x"'), ("ur-rtde", "dashboard_port = -1")],
)
def test_an_impossible_port_is_refused_by_its_key(driver: str, option: str, tmp_path: Path) -> None:
    cell = tmp_path / "hall.toml"
    cell.write_text(
        f'serial = "1"\n[robot]\ndriver = "{driver}"\n'
        f'[robot.options]\nhost = "127.0.0.1"\n{option}\n'
    )
    dialogue = TypedDialogue(Queue(), lambda _: None)
    with pytest.raises(SettingsError) as refused:
        WhichDevices(cell, CellText.read(cell), dialogue).perform()
    assert refused.value.source == "robot.options"
    assert refused.value.problems[0].startswith(f"{option.partition(' ')[0]}: ")


def test_floor_nests_need_no_drawing() -> None:
    assert drawing("none") == []
    assert nest_count("3") == 3
    with pytest.raises(ValueError, match=r"expected 3 \.\. 100 nests, got 2"):
        nest_count("2")


def test_what_a_floor_robot_has_is_kept_where_the_file_has_it() -> None:
    text = CellText('[layout]\nreflectors = "mounted"\n')
    write_floor_robot(text, 3)
    once = text.text
    write_floor_robot(text, 4)
    assert text.text == once
    assert text.get("layout.reflectors") == "mounted"
    assert [step.name for step in steps_of(text) if step.of_rail] == []
    floor = [Nest(**each) for each in text.values["layout"]["floor"]]
    assert [nest.name for nest in floor] == ["N1", "N2", "N3"]
    assert {nest.z_mm for nest in floor} == {UNPLACED_MM}


def test_what_a_person_types_of_volumes() -> None:
    assert volume_list("none") == ""
    assert taught_names("none") == []
    assert taught_names("fence, press 2") == ["fence", "press 2"]
    assert radii("300 220 250 180 150 120") == [300.0, 220.0, 250.0, 180.0, 150.0, 120.0]
    for parse, answer, why in (
        (taught_names, "fence,", "a letter or digit"),
        (taught_names, "fence, fence", "names must differ"),
        (radii, "0.3 0.22 0.25 0.18 0.15 0.12", "expected 5 .. 100000 mm, got 0.3"),
        (radii, "300 220 250", "expected 6 radii"),
        (radii, "300 220 nan 180 150 120", "got nan"),
        (volume_list, "nowhere.csv", "nowhere.csv"),
    ):
        with pytest.raises(ValueError, match=why):
            parse(answer)
