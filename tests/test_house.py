"""The house keeps its own rules: directions of imports, sizes, plain words."""

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

import grimp
import pytest

from hilcell.alarms.catalogue import catalogue

ROOT = Path(__file__).parents[1]
ROOMS_OF_CODE = ("hilcell", "drivers", "procedures", "fakes") + tuple(
    f"hilcell/{path.parent.name}" for path in sorted((ROOT / "hilcell").glob("*/__init__.py"))
)

PROSE = [
    path
    for room in ("hilcell", "drivers", "procedures", "fakes", "docs")
    for path in sorted((ROOT / room).rglob("*"))
    if path.suffix in (".py", ".toml", ".md", ".j2")
] + [ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
# Quaint words, and sentences or clauses that have "what" or "who" as their subject.
QUAINT = re.compile(
    r"\b(?:[Aa]new|[Tt]old|[Ww]hoever|[Gg]o(?:es)? with)\b"
    r"|(?:^|\"\"\"|(?<!#)# |[.!?;:] )(?:What|Who|Whatever) "
    r"|[;:] (?:what|who) (?!to )",
    re.MULTILINE,
)
TRAPS = {  # a motion or a result that would be wrong without notice; all else is a plain reason
    "drivers/canopen/cia.py": "a motion counts as ended that has not begun",
    "drivers/kuka/controller.py": "a stop is lost",
    "drivers/canopen/process_image.py": "a stop is undone",
    "drivers/kuka/program_krl/data.py": "a target is relative in disguise",
    "drivers/fanuc/program_tp.py": "an axis turns by 360 deg",
    "drivers/kuka/program_krl/program.py": "an axis turns by 360 deg",
    "drivers/leica/tracker_emscon.py": "a late result passes for the next point",
    "drivers/leica/tracker_geocom.py": "an old distance or a late answer passes for the next point",
    "drivers/spatialanalyzer/tracker_t2sa.py": "a late or simulated result passes for a reading",
    "hilcell/run/mover.py": "a station is missed by the backlash",
}


def test_no_modules_import_each_other_in_a_circle() -> None:
    """Imports for types alone count: a reader needs the modules below only."""
    house = grimp.build_graph("hilcell", "drivers", "procedures", "fakes", cache_dir=None)
    TopologicalSorter(
        {module: house.find_modules_directly_imported_by(module) for module in house.modules}
    ).prepare()


def test_no_vendor_is_named_outside_drivers() -> None:
    vendors = ("leica", "emscon", "geocom", "t2sa", "siko", "kuka", "krl", "fanuc")
    for room in ("hilcell", "procedures"):
        for path in (ROOT / room).rglob("*.py"):
            text = path.read_text("utf-8").lower()
            assert not [v for v in vendors if v in text], path


@pytest.mark.process
def test_help_is_quick_to_import() -> None:
    """What --help needs: nothing heavy. Timings stand in benchmarks/."""
    code = (
        "import sys, hilcell.commands.cli; print([m for m in ('numpy', 'scipy', 'rich', 'canopen', "
    )
    code += "'msgspec') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_no_text_becomes_code() -> None:
    """Whatever a file, a wire or another process holds: it is data."""
    code = re.compile(r"\b(?:import|from) pickle\b|\b(?:eval|exec)\(|shell=True|os\.system")
    rooms = ("hilcell", "drivers", "procedures", "fakes")
    paths = [path for room in rooms for path in sorted((ROOT / room).rglob("*.py"))]
    assert len(paths) > 300
    assert [path for path in paths if code.search(path.read_text("utf-8"))] == []


def test_words_are_plain() -> None:
    found = {
        (path.relative_to(ROOT).as_posix(), text[max(0, hit.start() - 30) : hit.end() + 30])
        for path in PROSE
        for text in [path.read_text("utf-8")]
        for hit in QUAINT.finditer(text)
    }
    assert sorted(found) == []


def test_a_trap_is_a_hazard() -> None:
    with_traps = [path for path in PROSE if re.search(r"The\s+traps?\b", path.read_text("utf-8"))]
    assert {path.relative_to(ROOT).as_posix() for path in with_traps} == set(TRAPS)


def test_no_text_holds_marks_of_a_merge() -> None:
    marks = re.compile(r"^(?:<{7}|={7}|>{7})(?: |$)", re.MULTILINE)
    texts = [*PROSE, ROOT / "CHANGELOG.md"]
    assert [path for path in texts if marks.search(path.read_text("utf-8"))] == []


def test_types_are_there_for_packages_beside_this_one() -> None:
    """A driver in a package of its own imports from these, and checks its types against them."""
    packages = ("hilcell", "drivers", "procedures", "fakes")
    assert [each for each in packages if not (ROOT / each / "py.typed").is_file()] == []


# -- errors ----------------------------------------------------------------------------------------

ERRORS = {"DeviceError", "DeviceRefused", "NoReading", "StripLost"}
DEVICES = {"RAIL", "STRIP", "ROBOT", "TRACKER"}
OF_A_DEVICE = {".failed", ".refused", ".no_reading"}  # methods of `drivers.device_errors.Device`
WORDED = {"HilcellError": 1, "SettingsError": 2}  # and of how many parts
# Nothing else was expected than what they lack: a connection, a sample, a beam, an operator.
LACKING = {"HC-R38", "HC-B21", "HC-T34", "HC-S12", "HC-C18", "HC-T40", "HC-T10", "HC-T11", "HC-C16"}


@pytest.mark.parametrize("room", ROOMS_OF_CODE)
def test_an_error_says_what_was_found_what_was_expected_and_what_to_do(room: str) -> None:
    folder = ROOT / room
    paths = folder.glob("*.py") if folder.name == "hilcell" else folder.rglob("*.py")
    short = [
        f"{path.relative_to(ROOT)}:{call.lineno} lacks {lacks}"
        for path in sorted(paths)
        for call in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(call, ast.Call) and isinstance(call.func, ast.Name | ast.Attribute)
        for lacks in lacking(call, called(call.func), path.relative_to(ROOT).as_posix())
    ]
    assert short == []


def called(function: ast.Name | ast.Attribute) -> str:
    """Return the name of a function, or of a method of a kind of device."""
    if isinstance(function, ast.Name):
        return function.id
    of_a_device = isinstance(function.value, ast.Name) and function.value.id in DEVICES
    return f".{function.attr}" if of_a_device else ""


def lacking(call: ast.Call, error: str, path: str) -> Iterator[str]:
    """Yield the parts that the call of an error's class does not give."""
    if error in WORDED and len(call.args) < WORDED[error]:
        yield "its words"
    if error not in ERRORS | OF_A_DEVICE:
        return
    code, *words = call.args
    if len(words) < 2 + (error in ERRORS) or any(
        isinstance(each, ast.Constant) and not each.value for each in words
    ):
        yield "a device, an operation or what was found"
    given = {each.arg for each in call.keywords}
    literal = code.value if isinstance(code, ast.Constant) else None
    entry = catalogue().get(str(literal))
    if "act" not in given and (entry is None or not entry.do):
        yield "what to do"
    if not given - {"act"} and literal not in LACKING:
        yield "what was expected"
