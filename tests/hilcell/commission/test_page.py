"""The page of a commissioning: names, times, values, and what nobody has proved."""

from pathlib import Path

import pytest

from hilcell.commission.page import CommissioningPage, page_html
from hilcell.commission.record import Check, Commissioned, StepRecord
from hilcell.commission.sequence import NAMES, STEPS
from hilcell.identity import Identity
from tests.hilcell.report.pages import Page

ROOT = Path(__file__).parents[3]
RAIL = "rail.options.counts_per_mm"
DRIVE = Identity("Rail", "EPOS4", "4711", "can0", kind="drive", maker="maxon", firmware="0x170")


def check(what: str, *, holds: bool = True, **values: float) -> Check:
    paths = {f"rail.options.{key}": value for key, value in values.items()}
    return Check(what=what, found=f"{what} read", expected="1", holds=holds, values=paths)


def performed(step: str, *checks: Check, minute: int = 0) -> StepRecord:
    return StepRecord(
        step=step,
        began=f"2026-11-29T10:{minute:02}:00+00:00",
        ended=f"2026-11-29T10:{minute:02}:40+00:00",
        operator="Ada",
        holds=all(each.holds for each in checks),
        checks=list(checks),
        run=f"run-{minute}",
        questions=2,
        devices=[DRIVE],
    )


@pytest.fixture
def cell(tmp_path: Path) -> Path:
    """A hall whose rail was proved at the second attempt, and nothing after it."""
    file = tmp_path / "hall.toml"
    file.write_text('name = "hall"\nserial = "HC-7"\n[rail.options]\ncounts_per_mm = -500.0\n')
    wrong = check("scale", holds=False, counts_per_mm=-500.0)
    for record in (
        *(performed(name) for name in NAMES[:3]),
        performed("rail", wrong, minute=1),
        performed("rail", check("scale"), check("stop"), minute=2),
    ):
        Commissioned.read(file).add(record, file)
    return file


def test_the_page_names_cell_devices_steps_people_and_times(cell: Path) -> None:
    page = Page(page_html(cell))
    for fact in (
        "hall, serial number HC-7",
        "NOT READY",
        "2026-11-29 10:00:00 to 2026-11-29 10:02:40 UTC; 0:03:20 in all, 10 questions",
        f"{RAIL} = -500",
        "maxon",
        "4711",
        CommissioningPage(cell).digest,
    ):
        assert fact in page.text
    assert page.text.count("name, signature") == 2
    assert page.links == []
    assert page.table("Steps")[NAMES.index("rail")] == {
        "step": "rail",
        "proves": STEPS[NAMES.index("rail")].title,
        "status": "proved",
        "operator": "Ada",
        "run": "run-2",
        "attempts": "2",
        "questions": "4",
        "took": "0:01:20",
        "ended, UTC": "2026-11-29 10:02:40",
    }
    proved = page.table("What each step has proved")
    assert [row["found"] for row in proved] == ["0 lacking or read only", "scale read", "stop read"]
    repeated = page.table("Repeated: readings of earlier attempts that differ")
    assert [row["found"] for row in repeated] == ["DIFFERS: scale read"]


def test_what_nobody_has_proved_is_listed(cell: Path) -> None:
    left = CommissioningPage(cell).not_proved()
    assert left[: len(NAMES) - 4] == [f"{step.name}: {step.title}." for step in STEPS[4:]]
    manual = (ROOT / "docs/commissioning.md").read_text("utf-8")
    bullets = manual.partition("## Not proved by it")[2].split("\n- ")[1:]
    leads = [line.split()[0].rstrip(":") for line in bullets]
    assert [line.split()[0] for line in left[len(NAMES) - 4 :]] == leads


def test_an_edit_of_a_value_that_an_earlier_attempt_wrote_opens_the_step(cell: Path) -> None:
    cell.write_text(cell.read_text().replace("-500.0", "-400.0"))
    page = CommissioningPage(cell)
    assert page.status(STEPS[NAMES.index("rail")]) == "changed"
    assert page.changed().rows == [["rail", RAIL, "-500.0", "-400.0"]]


def test_a_repeated_step_proves_what_a_person_has_corrected(cell: Path) -> None:
    cell.write_text(cell.read_text().replace("-500.0", "-400.0"))
    Commissioned.read(cell).add(performed("rail", check("scale"), minute=3), cell)
    assert CommissioningPage(cell).status(STEPS[NAMES.index("rail")]) == "proved"


def test_a_simulated_cell_is_not_to_be_signed(cell: Path) -> None:
    cell.write_text(cell.read_text() + '[simulation]\nsimulator = "paper"\n')
    text = Page(page_html(cell)).text
    assert "SIMULATION" in text
    assert "signature" not in text


def test_a_cell_without_a_record_has_a_page(tmp_path: Path) -> None:
    assert "not yet" in Page(page_html(tmp_path / "hall.toml")).text
