"""The manual says what is: the picture of the rooms, and every name of code or file."""

import ast
import pkgutil
import re
import tomllib
from pathlib import Path

import pytest

from hilcell.arguments import HOLES, TARGETS
from hilcell.cell.file import load_cell
from hilcell.compensation.targets import COLUMN, HEADER
from hilcell.programs.corrected import BOUNDS
from hilcell.programs.holes import NORMALS
from procedures.calibrate import CALIBRATE

ROOT = Path(__file__).parents[1]
NEIGHBOURS = ("drivers", "procedures", "fakes")
MANUAL = sorted(path.relative_to(ROOT).as_posix() for path in (ROOT / "docs").rglob("*.md"))
PAGES = ("README.md", "CONTRIBUTING.md", *MANUAL)
PICTURE = (ROOT / "docs/architecture.md").read_text("utf-8")
FLOWCHART = PICTURE.partition("```mermaid\nflowchart")[2].partition("```")[0]
CODE = re.compile(rf"(?<![\w./-])(?:hilcell|{'|'.join(NEIGHBOURS)}|benchmarks|campaigns)(?:\.\w+)+")
FILE = re.compile(rf"`((?:hilcell|{'|'.join(NEIGHBOURS)}|tests|docs)/[\w./-]+)`")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
GROUPS = PROJECT["project"]["entry-points"]
(LAYERS,) = (
    contract["layers"]
    for contract in PROJECT["tool"]["importlinter"]["contracts"]
    if contract.get("containers") == ["hilcell"]
)
ROOMS = {room for layer in LAYERS for room in layer.split(" | ")}
NO_MODULES = {*GROUPS, "hilcell.src", "hilcell.dat", "hilcell.mod"}
# Files that a reader of the examples writes.
EXAMPLES = ("tracker_lines", "floor_noise", "program_poses")

Arrow = tuple[str, str]


@pytest.mark.parametrize("header", [HEADER, NORMALS, BOUNDS, [*HEADER, COLUMN]])
def test_a_header_stands_in_the_manual(header: list[str]) -> None:
    assert f"| `{','.join(header)}` |" in (ROOT / "docs/lists.md").read_text("utf-8")


def test_the_help_says_the_headers_of_lists() -> None:
    assert ",".join(HEADER) == TARGETS
    assert ",".join(NORMALS) in HOLES


def test_the_minutes_of_a_calibration_are_those_that_are_planned() -> None:
    page = (ROOT / "docs/first-cell.md").read_text("utf-8")
    said = re.search(r"About (\d+) minutes; (\d+) with `--full`", page)
    assert said is not None
    for minutes, quick in zip(said.groups(), ("true", "false"), strict=True):
        plan = CALIBRATE.plan(load_cell("paper", {"plan.quick": quick}), 1)
        assert float(minutes) == pytest.approx(plan.duration_s / 60, rel=0.1), "docs/first-cell.md"


def room_of(module: str) -> str:
    """The room of a module by its full name; loose modules of the core are ``base``."""
    top, _, rest = module.partition(".")
    name = rest.partition(".")[0]
    if top in NEIGHBOURS:
        return top
    if name == "__main__":
        return "commands"
    return name if name in ROOMS else "base"


def imports(path: Path) -> set[str]:
    """The modules that a file imports when it runs, inside functions too."""
    found: set[str] = set()
    waiting: list[ast.AST] = [ast.parse(path.read_text("utf-8"))]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING":
            waiting += node.orelse
            continue
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
        waiting += (each for each in ast.iter_child_nodes(node) if not isinstance(each, ast.expr))
    return found


def arrows_between_rooms() -> set[Arrow]:
    """Every import from one room to another."""
    found: set[Arrow] = set()
    for top in ("hilcell", *NEIGHBOURS):
        for path in (ROOT / top).rglob("*.py"):
            room = room_of(".".join(path.relative_to(ROOT).with_suffix("").parts))
            ours = {
                name for name in imports(path) if name.split(".")[0] in ("hilcell", *NEIGHBOURS)
            }
            found |= {(room, other) for other in map(room_of, ours) if other != room}
    return found


def reach(arrows: set[Arrow], start: str) -> set[str]:
    """The rooms that are reached from ``start``."""
    found: set[str] = set()
    waiting = [start]
    while waiting:
        room = waiting.pop()
        new = {other for one, other in arrows if one == room} - found
        found |= new
        waiting += new
    return found


def drawn(sign: str) -> set[Arrow]:
    return {(one, other) for one, other in re.findall(rf"(\w+) {re.escape(sign)} (\w+)", FLOWCHART)}


def test_the_picture_shows_the_imports_that_exist() -> None:
    """The fewest arrows from which all the others follow."""
    arrows = arrows_between_rooms()
    needed = {
        (one, other) for one, other in arrows if other not in reach(arrows - {(one, other)}, one)
    }
    assert sorted(drawn("-->") ^ needed) == []


def test_the_dotted_arrows_are_the_entry_points() -> None:
    ours = {name: row for name, row in GROUPS.items() if name.startswith("hilcell.")}
    texts = ("hilcell.alarms", "hilcell.languages")  # name packages of files, which none loads
    groups = {name: row for name, row in ours.items() if name not in texts}
    targets = {target.partition(".")[0] for row in groups.values() for target in row.values()}
    loaders = {
        path.parent.name
        for path in (ROOT / "hilcell").rglob("*.py")
        if ".load()" in path.read_text("utf-8")
    }
    assert drawn("-.->") == {(loader, target) for loader in loaders for target in targets}


def test_the_table_has_every_room() -> None:
    named = set(re.findall(r"^\| `([\w/]+)(?:\.py)?` \|", PICTURE, re.MULTILINE))
    assert sorted(named ^ {*(f"hilcell/{room}" for room in ROOMS), *NEIGHBOURS}) == []


def test_the_glossary_is_in_order_and_every_term_has_its_module() -> None:
    lines = (ROOT / "docs/glossary.md").read_text("utf-8").splitlines()
    rows = [line.strip("|").split("|") for line in lines if line.startswith("| ")][1:]
    terms = [re.sub(r"[{}]", "", row[0]).strip().casefold() for row in rows]
    assert terms == sorted(terms)
    assert [row[0] for row in rows if not CODE.fullmatch(row[-1].strip(" `"))] == []


def test_the_manual_lists_every_page() -> None:
    index = (ROOT / "docs/README.md").read_text("utf-8")
    pages = {path.name for path in (ROOT / "docs").glob("*.md")} - {"README.md"}
    assert pages <= set(re.findall(r"\]\(([\w-]+\.md)\)", index))


@pytest.mark.parametrize("page", PAGES)
def test_pages_name_code_and_files_that_exist(page: str) -> None:
    text = (ROOT / page).read_text("utf-8")
    for name in set(CODE.findall(text)) - NO_MODULES:
        if not name.endswith(EXAMPLES):
            pkgutil.resolve_name(name)
    files = [name for name in FILE.findall(text) if not any(each in name for each in EXAMPLES)]
    assert [name for name in files if not (ROOT / name).exists()] == []
    links = re.findall(r"\]\(([^)#:]+)[^):]*\)", text)
    assert [link for link in links if not (ROOT / page).parent.joinpath(link).exists()] == []


def test_the_index_lists_every_decision_by_its_number() -> None:
    folder = ROOT / "docs/decisions"
    records = sorted(path.name for path in folder.glob("*.md") if path.name != "README.md")
    assert [int(name[:4]) for name in records] == list(range(1, len(records) + 1))
    index = (folder / "README.md").read_text("utf-8")
    listed = re.findall(r"^(\d+)\. \[.+\]\((.+)\)$", index, re.MULTILINE)
    assert listed == [(str(n), name) for n, name in enumerate(records, 1)]
    titles = [(folder / name).read_text("utf-8").split()[1] for name in records]
    assert titles == [f"{n}." for n in range(1, len(records) + 1)]
