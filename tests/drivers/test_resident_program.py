"""The controller's program as text: what the driver and it must agree on."""

import re
from importlib import resources
from xml.etree import ElementTree

from drivers.kuka import eki
from drivers.kuka.controller import PROGRAM_VERSION
from drivers.kuka.health import FRAME
from drivers.kuka.life import LIFE_S, TIMER
from drivers.kuka.robot_eki import DOCUMENTS_VERSION
from tests.drivers.kuka_peer import VARIABLES


def test_the_resident_program_declares_what_the_driver_uses() -> None:
    folder = resources.files("drivers.kuka") / "krl"
    source = (folder / "hilcell.src").read_text("ascii")
    data = (folder / "hilcell.dat").read_text("ascii")
    declared = set(re.findall(r"DECL GLOBAL \w+ (HC_\w+)", data))
    assert declared == {name for name in VARIABLES if name.startswith("HC_")}
    routines = set(re.findall(r"^DEF(?:FCT BOOL)? (HC_\w+)", source, re.MULTILINE))
    used = set(re.findall(r"\bHC_[A-Z_]+\b", re.sub(r"(?m)^\s*;.*$", "", source)))
    assert used | {"HC_OV_OLD", "HC_OV_SET"} == declared | routines  # those two the PC alone uses
    assert source.count("\nDEF ") + source.count("\nDEFFCT ") == len(
        re.findall(r"(?m)^END(?:FCT)?$", source)
    )


def test_the_program_and_the_driver_have_one_timer_and_one_version() -> None:
    folder = resources.files("drivers.kuka") / "krl"
    source = (folder / "hilcell.src").read_text("ascii")
    data = (folder / "hilcell.dat").read_text("ascii")
    number = TIMER.removeprefix("$TIMER")
    assert set(re.findall(r"\$TIMER(?:_STOP|_FLAG)?(\[\d+\])", source)) == {number}
    assert f"HC_VER = {PROGRAM_VERSION}\n" in source
    assert f"HC_VER={PROGRAM_VERSION}\n" in data
    assert f"HC_LIFE={1000 * LIFE_S:.0f}\n" in data


def test_what_brakes_the_robot_keeps_the_other_brake_out() -> None:
    """Both interrupts are off before the brake, and RESUME leaves the motion's level."""
    source = (resources.files("drivers.kuka") / "krl" / "hilcell.src").read_text("ascii")
    for routine in ("HC_BRAKE", "HC_LOST"):
        (lines,) = re.findall(rf"(?ms)^DEF {routine} \( \)\n(.*?)^END$", source)
        acts = [line.strip() for line in lines.splitlines() if not line.startswith(";")]
        assert {*acts[:2]} == {"INTERRUPT OFF 21", "INTERRUPT OFF 22"}
        assert acts[2] == "BRAKE F"
        assert acts[-1] == "RESUME"


def eki_text(name: str) -> str:
    return (resources.files("drivers.kuka") / "eki_krl" / name).read_text("ascii")


def configured(name: str, part: str) -> set[str]:
    root = ElementTree.fromstring(eki_text(name))
    return {str(element.get("Tag")) for element in root.findall(f"{part}/XML/ELEMENT")}


def tags(document: bytes) -> set[str]:
    """Return the paths of a document's attributes."""
    root = ElementTree.fromstring(document)
    paths = {f"{root.tag}/@{name}" for name in root.attrib}
    return paths | {f"{root.tag}/{each.tag}/@{name}" for each in root for name in each.attrib}


def test_the_interface_is_configured_for_all_that_the_driver_sends() -> None:
    """A value without a queue, or a queue without a value, shifts what the program takes."""
    assert configured("HilcellEki.xml", "RECEIVE") == tags(eki.command(1, eki.MOVE))
    assert configured("HilcellStop.xml", "RECEIVE") == tags(eki.stop_command(1, brake=True))


def test_the_interface_is_configured_for_all_that_the_driver_reads() -> None:
    sent = configured("HilcellEki.xml", "SEND")
    read = {f"RobotState/{element}/@{attribute}" for element, attribute in eki.SINGLE.values()}
    places = [*eki.AXES, eki.E1, *FRAME]
    read |= {"RobotState/Command/@Id"} | {f"RobotState/Pos/@{name}" for name in places}
    read |= {f"RobotState/{frame}/@{name}" for frame in ("Tool", "Base") for name in FRAME}
    assert read == sent - {"RobotState/Pos/@S", "RobotState/Pos/@T"}
    assert configured("HilcellStop.xml", "SEND") == {"RobotStopState/Command/@Id"}


def test_the_submit_program_takes_and_sets_each_value_once() -> None:
    """Strings that differ in one letter are no error on a controller, only a value that stays 0."""
    source = eki_text("hilcell_eki.src")
    taken = re.findall(r'EKI_Get\w+ \("(\w+)", "([^"]+)"', source)
    assert len(taken) == len(set(taken))
    assert {tag for name, tag in taken if name == "HilcellEki"} == configured(
        "HilcellEki.xml", "RECEIVE"
    )
    assert {tag for name, tag in taken if name == "HilcellStop"} == configured(
        "HilcellStop.xml", "RECEIVE"
    )
    put = set(re.findall(r'"(Robot\w+/[^"]+)"', source)) - {tag for _, tag in taken}
    received = configured("HilcellEki.xml", "RECEIVE") | configured("HilcellStop.xml", "RECEIVE")
    assert (
        put
        == (configured("HilcellEki.xml", "SEND") | configured("HilcellStop.xml", "SEND")) - received
    )
    assert f"HE_VER={DOCUMENTS_VERSION}\n" in eki_text("hilcell_eki.dat")


def test_the_submit_program_uses_what_is_declared() -> None:
    source, data = eki_text("hilcell_eki.src"), eki_text("hilcell_eki.dat")
    declared = set(re.findall(r"DECL (?:GLOBAL )?\w+ (HE_\w+)=", data))
    routines = set(re.findall(r"^DEF (\w+) ", source, re.MULTILINE))
    used = set(re.findall(r"\bHE_[A-Z_0-9]+\b", re.sub(r"(?m)^\s*;.*$", "", source)))
    assert used == (declared | routines) - {"hilcell_eki"}
    assert set(re.findall(r"\bHC_[A-Z_]+\b", source)) <= set(VARIABLES)
    assert source.count("\nDEF ") == len(re.findall(r"(?m)^END$", source))
    for word in ("IF", "SWITCH"):
        begun = len(re.findall(rf"(?m)^\s*{word} ", source))
        assert begun == len(re.findall(rf"(?m)^\s*END{word}$", source))
    types = [*range(eki.MOVE, eki.MOVE_SLIDE + 1)]
    hear = source.split("DEF HE_HEAR ( )")[1].split("\nEND\n")[0]
    assert [int(n) for n in re.findall(r"CASE (\d)", hear)] == types
    assert hear.index("$TIMER[10] = -HE_MS") < hear.index("SWITCH")
