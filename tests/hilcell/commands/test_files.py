"""``files``: what the controllers of devices need, from an installed package."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import zipfile
from importlib import resources
from pathlib import Path
from xml.etree import ElementTree

import pytest

from tests.whole.bench import command

ROOT = Path(__file__).parents[3]
CELL = (resources.files("hilcell.cells") / "paper.toml").read_text("utf-8")
SIDES = {
    "abb-egm": {"hilcell.mod"},
    "canopen": {"drive.eds", "strip.eds"},
    "kuka-c3": {"hilcell.src", "hilcell.dat"},
    "kuka-eki": {
        "hilcell.src", "hilcell.dat", "hilcell_eki.src", "hilcell_eki.dat", "HilcellEki.xml",
        "HilcellStop.xml",
    },
    "ur-rtde": {"hilcell.script"},
}  # fmt: skip


def test_drivers_are_listed_with_their_files() -> None:
    listed = json.loads(command("files", "--json").stdout)
    assert {name: {*row["files"]} for name, row in listed.items()} == SIDES
    assert all(row["version"] and row["title"] for row in listed.values())
    assert all(name in command("files").stdout for name in SIDES)


@pytest.mark.parametrize("driver", SIDES)
def test_files_are_those_that_ship_and_have_a_page(driver: str, tmp_path: Path) -> None:
    folder = tmp_path / "new" / "folder"
    assert command("files", driver, "-o", folder).returncode == 0
    assert {path.name for path in folder.iterdir()} == SIDES[driver] | {"README.md"}
    shipped = {path.name: path for path in (ROOT / "drivers").rglob("*") if path.is_file()}
    for name in SIDES[driver]:
        assert (folder / name).read_bytes() == shipped[name].read_bytes(), name
    page = (folder / "README.md").read_text("utf-8")
    assert all(f"| `{name}` |" in page for name in SIDES[driver])
    assert "\n1. " in page
    assert "\n3. " in page


def test_values_that_no_cell_gives_are_named(tmp_path: Path) -> None:
    done = command("files", "abb-egm", "-o", tmp_path / "bare")
    assert "hc_tool" in done.stderr
    assert "--cell" in done.stderr
    given = command("files", "abb-egm", "--cell", "abb", "-o", tmp_path / "mine", "--json")
    assert json.loads(given.stdout)["lacks"] == []


def test_values_of_a_cell_are_filled_in(tmp_path: Path) -> None:
    cell, folder = tmp_path / "mine.toml", tmp_path / "eki"
    options = {"host": '"10.1.2.3"', "port": 54700, "stop_port": 54701, "tool": 7, "base": 3}
    stated = ", ".join(f"{key} = {value}" for key, value in options.items())
    text = re.sub(r"\[robot.options\]\n.*\n", "", CELL)
    text = text.replace("[robot]\n", f"[robot]\noptions = {{ {stated} }}\n")
    text = text.replace('driver = "kuka-c3"', 'driver = "kuka-eki"')
    cell.write_text(text, "utf-8")
    assert command("files", "kuka-eki", "--cell", cell, "-o", folder).returncode == 0
    for name, port in (("HilcellEki", "54700"), ("HilcellStop", "54701")):
        root = ElementTree.fromstring((folder / f"{name}.xml").read_text("ascii"))
        internal = root.find(".//INTERNAL")
        assert internal is not None
        assert (internal.findtext("IP"), internal.findtext("PORT")) == ("10.1.2.3", port)
    source = (folder / "hilcell.src").read_text("ascii")
    assert "BAS (#TOOL, 7)" in source
    assert "BAS (#BASE, 3)" in source
    page = (folder / "README.md").read_text("utf-8")
    for part in ("10.1.2.3", "54700 and 54701", "tool 7: X 98.000 mm, Y 0.000", "Base 3"):
        assert part in page, part


def test_a_changed_file_is_replaced_by_force_only(tmp_path: Path) -> None:
    write = ("files", "kuka-c3", "-o", tmp_path)
    assert command(*write).returncode == command(*write).returncode == 0
    changed = tmp_path / "hilcell.src"
    shipped = changed.read_bytes()
    changed.write_bytes(shipped.replace(b"[10]", b"[11]"))
    refused = command(*write)
    assert refused.returncode == 2
    assert "hilcell.src" in refused.stderr
    assert "hilcell.dat" not in refused.stderr
    assert b"[11]" in changed.read_bytes()
    assert command(*write, "--force").returncode == 0
    assert changed.read_bytes() == shipped


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (("kuka-c4",), "kuka-c3"),
        (("leica-geocom",), "needs no files"),
        (("kuka-eki", "--cell", "paper"), "robot.driver"),
    ],
)
def test_other_drivers_are_refused(words: tuple[str, ...], found: str, tmp_path: Path) -> None:
    done = command("files", *words, "-o", tmp_path / "none")
    assert done.returncode == 2
    assert found in done.stderr
    assert not (tmp_path / "none").exists()
    assert command("files", "kuka-c3").returncode == 2  # no folder


@pytest.mark.process
def test_files_come_from_a_package_in_a_zip_too(tmp_path: Path) -> None:
    """Package data only: no path of a source tree."""
    packed = tmp_path / "packed.zip"
    with zipfile.ZipFile(packed, "w") as archive:
        for package in ("hilcell", "drivers"):
            for path in (ROOT / package).rglob("*"):
                if path.is_file() and path.suffix != ".pyc":
                    archive.write(path, path.relative_to(ROOT))
    code = (
        "import sys; sys.path.insert(0, sys.argv.pop(1)); import drivers; "
        "assert drivers.__file__.startswith(sys.path[0]), drivers.__file__; "
        "from hilcell.commands.cli import main; sys.exit(main(sys.argv[1:]))"
    )
    words = [str(packed), "files", "kuka-eki", "-o", str(tmp_path / "out")]
    line = [sys.executable, "-P", "-c", code, *words]
    done = subprocess.run(line, capture_output=True, text=True, cwd=tmp_path, check=False)
    assert done.returncode == 0, done.stderr
    assert len([*(tmp_path / "out").iterdir()]) == len(SIDES["kuka-eki"]) + 1
