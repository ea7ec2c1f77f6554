"""The controller's program as text: what the driver and it must agree on."""

import re
from importlib import resources
from xml.etree import ElementTree

import pytest

from drivers.kuka import robot_eki as eki
from drivers.kuka.controller import PROGRAM_VERSION
from drivers.kuka.krl import JOINTS, POSE, SLIDE
from drivers.kuka.robot_c3 import C3Controller
from drivers.supervision import HEARTBEAT_TIMEOUT_S
from tests.drivers.kuka.kuka_peer import VARIABLES


def text_of(name: str) -> str:
    return (resources.files("drivers.kuka") / name).read_text("ascii")


SOURCE, DATA = text_of("krl/hilcell.src"), text_of("krl/hilcell.dat")
EKI_SOURCE, EKI_DATA = text_of("eki_krl/hilcell_eki.src"), text_of("eki_krl/hilcell_eki.dat")


PROGRAMS = [
    f"{folder}/{each.name}"
    for folder in ("krl", "eki_krl")
    for each in (resources.files("drivers.kuka") / folder).iterdir()
    if each.name.endswith((".src", ".dat", ".sub"))
]
# Words of KRL, its types and its operators: none may be a name. The interpreter is blind to case.
KEYWORDS = """
ANIN ANOUT ANY BRAKE C_DIS C_ORI C_PTP C_VEL CASE CAST_FROM CAST_TO CCLOSE CHANNEL CIOCTL CIRC
CIRC_REL CONFIRM CONST CONST_KEY CONTINUE COPEN CREAD CWRITE DECL DEF DEFAULT DEFDAT DEFFCT
DELAY DIGIN DISTANCE DO ELSE END ENDDAT ENDFCT ENDFOR ENDIF ENDLOOP ENDSPLINE ENDSWITCH
ENDWHILE ENUM ERR_RAISE EXIT EXT EXTFCT EXTFCTP EXTP FOR GLOBAL GOTO HALT IF IMPORT INTERRUPT
IS LIN LIN_REL LOOP MAXIMUM MINIMUM OFF ON PATH PRIO PTP PTP_REL PUBLIC PULSE REPEAT RESUME
RETURN SCIRC SEC SIGNAL SLIN SPL SPLINE SPTP SREAD STEP STRUC SWITCH SWRITE SYNC THEN TO
TRIGGER UNTIL WAIT WHEN WHILE WITH CCOMP
AND OR NOT EXOR B_AND B_OR B_EXOR B_NOT TRUE FALSE
INT REAL BOOL CHAR POS E6POS AXIS E6AXIS FRAME LOAD
"""


def named(source: str) -> list[str]:
    """Return the names that a program or data list gives: of routines, variables and labels."""
    code = re.sub(r'"[^"]*"|;.*', "", source)
    bare = re.sub(r"=[^,\n]*", "", re.sub(r"\[[^]]*\]|\{[^}]*\}", "", code))
    found = []
    for name, parameters in re.findall(
        r"(?im)^\s*(?:GLOBAL\s+)?(?:DEF|DEFFCT\s+\w+|DEFDAT)\s+([\w$]+)(?:\s*\((.*)\))?", bare
    ):
        found += [name, *(each.split(":")[0].strip() for each in parameters.split(","))]
    for names in re.findall(
        r"(?im)^\s*(?:DECL\s+)?(?:GLOBAL\s+|CONST\s+)*"
        r"(?:INT|REAL|BOOL|CHAR|E?6?POS|E?6?AXIS|FRAME|EKI_STATUS)\s+(.+)$",
        bare,
    ):
        found += [each.strip() for each in names.split(",")]
    found += re.findall(r"(?m)^\s*([\w$]+)\s*:\s*$", bare)
    return [name for name in found if name]


@pytest.mark.parametrize("program", PROGRAMS)
def test_no_name_is_a_keyword_or_too_long(program: str) -> None:
    """The compiler of a controller refuses the whole module otherwise."""
    source = text_of(program)
    declarations = re.findall(r"(?m)^\s*DECL .*", re.sub(r";.*", "", source))
    names = named(source)
    assert len(names) > len(declarations) > 0
    assert [name for name in names if name.upper() in KEYWORDS.split()] == []
    assert [name for name in names if not re.fullmatch(r"[A-Za-z_$][\w$]{0,23}", name)] == []


def test_names_are_found_wherever_they_are_given() -> None:
    routines = "DEF A (B[] :OUT, ON :IN)\nGLOBAL DEFFCT BOOL C ( )\nDEFDAT D PUBLIC\n; INT I\n"
    variables = "DECL GLOBAL E6AXIS E={A1 0.0, A2 1.0}\nDECL INT F, G[3]\n  REAL H=1.0\n"
    assert named(routines + variables + "MARK:") == [*"AB", "ON", *"CDEFGH", "MARK"]


def used(source: str, prefix: str) -> set[str]:
    """Return the names of a program that begin so, outside of comments."""
    return set(re.findall(rf"\b{prefix}_[A-Z_0-9]+\b", re.sub(r"(?m)^\s*;.*$", "", source)))


@pytest.mark.parametrize("source", [SOURCE, EKI_SOURCE])
def test_blocks_are_closed(source: str) -> None:
    for begin, end in (("DEF(?:FCT)? ", "END(?:FCT)?"), ("IF ", "ENDIF"), ("SWITCH ", "ENDSWITCH")):
        begun = re.findall(rf"(?m)^\s*{begin}", source)
        assert len(begun) == len(re.findall(rf"(?m)^\s*{end}$", source))


def test_the_resident_program_declares_what_the_driver_uses() -> None:
    declared = set(re.findall(r"DECL GLOBAL \w+ (HC_\w+)", DATA))
    assert declared == {name for name in VARIABLES if name.startswith("HC_")}
    routines = set(re.findall(r"^DEF(?:FCT BOOL)? (HC_\w+)", SOURCE, re.MULTILINE))
    alone = {"HC_OV_OLD", "HC_OV_SET"}  # the PC's
    assert used(SOURCE, "HC") | alone == declared | routines


def test_the_program_and_the_driver_have_one_timer_and_one_version() -> None:
    number = C3Controller.TIMER.removeprefix("$TIMER")
    assert set(re.findall(r"\$TIMER(?:_STOP|_FLAG)?(\[\d+\])", SOURCE)) == {number}
    assert f"HC_VER = {PROGRAM_VERSION}\n" in SOURCE
    assert f"HC_VER={PROGRAM_VERSION}\n" in DATA
    assert f"HC_LIFE={1000 * HEARTBEAT_TIMEOUT_S:.0f}\n" in DATA


@pytest.mark.parametrize("routine", ["HC_BRAKE", "HC_LOST"])
def test_a_brake_keeps_the_other_brake_out(routine: str) -> None:
    """Both interrupts are off before the brake, and RESUME leaves the motion's level."""
    (lines,) = re.findall(rf"(?ms)^DEF {routine} \( \)\n(.*?)^END$", SOURCE)
    acts = [line.strip() for line in lines.splitlines() if not line.startswith(";")]
    assert {*acts[:2]} == {"INTERRUPT OFF 21", "INTERRUPT OFF 22"}
    assert acts[2] == "BRAKE F"
    assert acts[-1] == "RESUME"


def configured(name: str, part: str) -> set[str]:
    root = ElementTree.fromstring(text_of(f"eki_krl/{name}.xml"))
    return {str(element.get("Tag")) for element in root.findall(f"{part}/XML/ELEMENT")}


TAKEN = {name: configured(name, "RECEIVE") for name in ("HilcellEki", "HilcellStop")}
SENT = {name: configured(name, "SEND") for name in TAKEN}


def tags(document: bytes) -> set[str]:
    """Return the paths of a document's attributes."""
    root = ElementTree.fromstring(document)
    paths = {f"{root.tag}/@{name}" for name in root.attrib}
    return paths | {f"{root.tag}/{each.tag}/@{name}" for each in root for name in each.attrib}


def test_the_interface_is_configured_for_all_that_the_driver_sends() -> None:
    """A value without a queue, or a queue without a value, shifts what the program takes."""
    assert TAKEN["HilcellEki"] == tags(eki.command(1, eki.Kind.MOVE))
    assert TAKEN["HilcellStop"] == tags(eki.stop_command(1, brake=True))


def test_the_interface_is_configured_for_all_that_the_driver_reads() -> None:
    read = {f"RobotState/{element}/@{attribute}" for element, attribute in eki.SINGLE.values()}
    places = [*JOINTS, SLIDE, *POSE]
    read |= {"RobotState/Command/@Id"} | {f"RobotState/Pos/@{name}" for name in places}
    read |= {f"RobotState/{frame}/@{name}" for frame in ("Tool", "Base") for name in POSE}
    read |= {f"RobotState/{end}/@{name}" for end in ("Low", "High") for name in (*JOINTS, SLIDE)}
    assert read == SENT["HilcellEki"] - {"RobotState/Pos/@S", "RobotState/Pos/@T"}
    assert SENT["HilcellStop"] == {"RobotStopState/Command/@Id"}


def test_the_submit_program_takes_and_sets_each_value_once() -> None:
    """Strings that differ in one letter are no error on a controller, only a value that stays 0."""
    taken = re.findall(r'EKI_Get\w+ \("(\w+)", "([^"]+)"', EKI_SOURCE)
    assert len(taken) == len(set(taken))
    for name, expected in TAKEN.items():
        assert {tag for channel, tag in taken if channel == name} == expected
    put = set(re.findall(r'"(Robot\w+/[^"]+)"', EKI_SOURCE)) - {tag for _, tag in taken}
    assert put == set().union(*SENT.values()) - set().union(*TAKEN.values())
    assert f"HE_VER={eki.EkiController.DOCUMENTS_VERSION}\n" in EKI_DATA


def test_the_submit_program_uses_what_is_declared() -> None:
    declared = set(re.findall(r"DECL (?:GLOBAL )?\w+ (HE_\w+)=", EKI_DATA))
    routines = set(re.findall(r"^DEF (\w+) ", EKI_SOURCE, re.MULTILINE))
    assert used(EKI_SOURCE, "HE") == (declared | routines) - {"hilcell_eki"}
    assert used(EKI_SOURCE, "HC") <= set(VARIABLES)


def test_a_command_gives_its_time_before_it_acts() -> None:
    hear = EKI_SOURCE.split("DEF HE_HEAR ( )")[1].split("\nEND\n")[0]
    types = [int(number) for number in re.findall(r"CASE (\d)", hear)]
    assert types == [*range(eki.Kind.MOVE, max(eki.Kind) + 1)]
    assert hear.index("$TIMER[10] = -HE_MS") < hear.index("SWITCH")


def lines_of(routine: str) -> list[str]:
    """Return the lines of a routine of the submit program, without comments."""
    (text,) = re.findall(rf"(?ms)^DEF {routine} \( \)\n(.*?)^END$", EKI_SOURCE)
    return [line.strip() for line in text.splitlines() if not line.startswith(";")]


def test_a_document_is_read_when_its_last_value_has_come() -> None:
    checked = dict(re.findall(r'EKI_CheckBuffer \("(\w+)", "([^"]+)"', EKI_SOURCE))
    documents = {
        "HilcellEki": eki.command(1, eki.Kind.MOVE),
        "HilcellStop": eki.stop_command(1, brake=True),
    }
    for name, document in documents.items():
        last = re.findall(rb'(\w+)="', document)[-1].decode()
        assert checked[name].endswith(f"/@{last}")


def test_a_stop_is_read_before_its_channel_is_cleared() -> None:
    """What a client has sent stays value_errors after it has gone, until EKI_Clear."""
    lines = lines_of("hilcell_eki")
    cycle = lines[lines.index("ENDIF") + 1 :]
    assert cycle[:2] == ["GONE = NOT $FLAG[911]", "HE_HEAR_STOPS ( )"]
    assert cycle.count("HE_OPEN_STOPS ( )") == 1
    assert "EKI_Clear" not in "".join(lines_of("HE_HEAR_STOPS") + lines_of("HE_HEAR_STOP"))


def test_a_stop_that_cannot_be_read_brakes() -> None:
    lines = lines_of("HE_HEAR_STOP")
    read = lines.index('RET = EKI_GetInt ("HilcellStop", "RobotStop/@Brake", BRAKES)')
    assert lines[read + 1 : read + 3] == [
        "IF (RET.MSG_NO<>0) OR (BRAKES<>0) THEN",
        "HC_STOP = TRUE",
    ]
    assert "ID = 0" in lines[:read]  # a variable without a value halts the interpreter


def test_a_command_acts_only_where_each_read_has_succeeded() -> None:
    """A read that fails leaves the last command's value, and a type of 1 is a motion."""
    lines = lines_of("HE_TAKE")
    reads = [n for n, line in enumerate(lines) if "EKI_Get" in line]
    assert len(reads) == len(TAKEN["HilcellEki"])
    for n in reads:
        assert lines[n + 1] == "HE_WHOLE = HE_WHOLE AND (RET.MSG_NO==0)"
    assert {"HE_WHOLE = TRUE", "HE_ID = 0", "HE_TYPE = 0", "HE_MS = 0"} <= {*lines[: reads[0]]}
    hear = lines_of("HE_HEAR")
    taken = hear.index("HE_TAKE ( )")
    assert hear[taken + 1 : taken + 4] == ["IF NOT HE_WHOLE THEN", "HE_LOSE ( )", "RETURN"]


def test_a_motion_whose_client_has_gone_brakes() -> None:
    begin = ["IF HC_SEQ <> HC_ACK THEN", "HC_STOP = TRUE", "ENDIF", "HE_OPEN_COMMANDS ( )"]
    assert lines_of("HE_LOSE") == begin
    assert lines_of("hilcell_eki")[-5:] == [
        "ELSE",
        "IF HE_SEEN THEN",
        "HE_LOSE ( )",
        "ENDIF",
        "ENDIF",
    ]


@pytest.mark.parametrize(
    ("routine", "channel"), [("HE_OPEN_COMMANDS", "HilcellEki"), ("HE_OPEN_STOPS", "HilcellStop")]
)
def test_nothing_is_cleared_before_it_was_opened(routine: str, channel: str) -> None:
    """EKI_Clear of a channel without EKI_Init is a message at the panel."""
    clear, init, opened = (f'RET = EKI_{name} ("{channel}")' for name in ("Clear", "Init", "Open"))
    assert lines_of(routine)[1:6] == ["IF HE_OPEN THEN", clear, "ENDIF", init, opened]
    start = lines_of("hilcell_eki")
    assert start.index(f"{routine} ( )") < start.index("HE_OPEN = TRUE")


@pytest.mark.parametrize(("name", "flag"), [("HilcellEki", "910"), ("HilcellStop", "911")])
def test_a_client_without_a_cable_is_found_and_no_message_waits(name: str, flag: str) -> None:
    internal = ElementTree.fromstring(text_of(f"eki_krl/{name}.xml")).find(".//INTERNAL")
    assert internal is not None
    alive, messages = internal.find("ALIVE"), internal.find("MESSAGES")
    assert alive is not None
    assert messages is not None
    assert (alive.get("Set_Flag"), messages.get("Display")) == (flag, "disabled")
    assert 0 < int(alive.get("Ping", "0")) < 60
    assert f"$FLAG[{flag}]" in EKI_SOURCE
