"""docs/conformance.md has the promises as they are."""

from pathlib import Path

from hilcell.conformance.kit import PROMISES
from hilcell.conformance.page import renewed

PAGE = Path(__file__).parents[3] / "docs" / "conformance.md"


def test_the_table_is_generated() -> None:
    text = PAGE.read_text("utf-8")
    assert renewed(text) == text
    assert all(f"`{promise.name}`" in text for promise in PROMISES)
