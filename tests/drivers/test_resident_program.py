"""The controller's program as text: what the driver and it must agree on."""

import re
from importlib import resources

from drivers.kuka_life import LIFE_S, LIVING_VERSION, TIMER
from tests.drivers.kuka_peer import VARIABLES


def test_the_resident_program_declares_what_the_driver_uses() -> None:
    folder = resources.files("drivers") / "krl"
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
    folder = resources.files("drivers") / "krl"
    source = (folder / "hilcell.src").read_text("ascii")
    data = (folder / "hilcell.dat").read_text("ascii")
    number = TIMER.removeprefix("$TIMER")
    assert set(re.findall(r"\$TIMER(?:_STOP|_FLAG)?(\[\d+\])", source)) == {number}
    assert f"HC_VER = {LIVING_VERSION}\n" in source
    assert f"HC_VER={LIVING_VERSION}\n" in data
    assert f"HC_LIFE={1000 * LIFE_S:.0f}\n" in data


def test_what_brakes_the_robot_keeps_the_other_brake_out() -> None:
    """Both interrupts are off before the brake, and RESUME leaves the motion's level."""
    source = (resources.files("drivers") / "krl" / "hilcell.src").read_text("ascii")
    for routine in ("HC_BRAKE", "HC_LOST"):
        (lines,) = re.findall(rf"(?ms)^DEF {routine} \( \)\n(.*?)^END$", source)
        acts = [line.strip() for line in lines.splitlines() if not line.startswith(";")]
        assert {*acts[:2]} == {"INTERRUPT OFF 21", "INTERRUPT OFF 22"}
        assert acts[2] == "BRAKE F"
        assert acts[-1] == "RESUME"
