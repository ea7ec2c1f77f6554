"""The manual as a site, as far as it can be checked without a build: contents, links, anchors."""

import pkgutil
import re
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import pytest

import hilcell as hc

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
CONFIGURATION = (ROOT / "mkdocs.yml").read_text("utf-8")
INDEX = (DOCS / "README.md").read_text("utf-8")
API = (DOCS / "python-api.md").read_text("utf-8")
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(DOCS.rglob("*.md"))]
PAGES = [page for page in PAGES if DOCS / "examples" not in page.parents]
SCRIPTS = sorted((DOCS / "tutorials").glob("*.py"))
PARTS = ("Tutorials", "How-to", "Reference", "Explanation")


class Entry(NamedTuple):
    """A page of the contents, by its source, and the part in which it stands."""

    part: str
    source: Path


def contents() -> list[Entry]:
    """The pages that mkdocs.yml lists; those of scripts and of CONTRIBUTING.md are made."""
    entries, part = [], ""
    for line in CONFIGURATION.partition("\nnav:\n")[2].splitlines():
        named = line.strip(" -")
        if named.endswith(":"):
            part = named[:-1] if named[:-1] in PARTS else part
            continue
        source = DOCS / named
        if named.startswith("tutorials/"):
            source = source.with_suffix(".py")
        entries.append(
            Entry(part, ROOT / "CONTRIBUTING.md" if named == "contributing.md" else source)
        )
    return entries


def test_the_contents_have_every_page_once() -> None:
    listed = [entry.source for entry in contents()]
    pages = [page for page in PAGES if page != ROOT / "README.md"]
    assert Counter(listed) == Counter([*pages, *SCRIPTS])


def test_the_parts_are_those_of_the_index() -> None:
    parts = re.split(r"^## (.+)$", INDEX, flags=re.MULTILINE)
    assert tuple(parts[1::2]) == PARTS
    indexed = [
        Entry(part, (DOCS / link).resolve())
        for part, text in zip(parts[1::2], parts[2::2], strict=True)
        for link in re.findall(r"^\| \[[^\]]+\]\(([^)]+)\)", text, flags=re.MULTILINE)
    ]
    decisions = DOCS / "decisions"
    listed = [each for each in contents() if each.part]
    assert indexed == [
        each
        for each in listed
        if each.source.parent != decisions or each.source.name == "README.md"
    ]


# -- links -----------------------------------------------------------------------------------------


def prose(page: Path) -> str:
    """A page without its blocks of code."""
    return re.sub(
        r"^( *)```.*?^\1```$", "", page.read_text("utf-8"), flags=re.DOTALL | re.MULTILINE
    )


def anchors(page: Path) -> set[str]:
    """The anchors of a page's headings; headings of one name are numbered."""
    found: set[str] = set()
    counted: Counter[str] = Counter()
    for heading in re.findall(r"^#{1,6} (.+)$", prose(page), flags=re.MULTILINE):
        plain = re.sub(r"\[([^\]]*)\]\([^)]*\)|[`*]", r"\1", heading).strip().casefold()
        slug = re.sub(r"\s", "-", re.sub(r"[^\w\- ]", "", plain))
        found.add(f"{slug}-{counted[slug]}" if counted[slug] else slug)
        counted[slug] += 1
    return found


def links(page: Path) -> list[str]:
    """The links to files and anchors, without those to other sites."""
    text = re.sub(r"`[^`\n]*`", "``", prose(page))
    found = re.findall(r"\]\(([^()\s]+(?:\([^()]*\))?)\)", text)
    return [link for link in found if not re.match(r"[a-z]+:", link)]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_links_lead_to_files_and_headings_that_exist(page: Path) -> None:
    broken = []
    for link in links(page):
        path, _, anchor = link.partition("#")
        there = (page.parent / path).resolve() if path else page
        wanted = anchor if there.suffix == ".md" else ""
        if not there.exists() or (wanted and wanted not in anchors(there)):
            broken.append(link)
    assert broken == []


def test_headings_have_the_anchors_of_the_site(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# The `a_b` of {W}\n```\n# no heading\n```\n## Same\n## Same\n### 1. A, (b)\n")
    assert anchors(page) == {"the-a_b-of-w", "same", "same-1", "1-a-b"}


# -- the Python API --------------------------------------------------------------------------------


def test_the_api_describes_every_name_of_the_library() -> None:
    described = re.findall(r"^::: (\S+)$", API, flags=re.MULTILINE)
    modules: dict[str, str] = hc._MODULES  # type: ignore[attr-defined]
    assert {f"{module}.{name}" for name, module in modules.items()} <= {*described}
    assert "hilcell.ports" in described
    for name in described:
        assert pkgutil.resolve_name(name).__doc__
    table = re.findall(r"`(\w+)`", API.partition("\n## ")[0])
    assert {*hc.__all__} <= {*table}


def test_members_of_the_api_exist() -> None:
    for name, options in re.findall(r"^::: (\S+)\n((?:    .*\n)+)", API, flags=re.MULTILINE):
        for member in re.findall(r"\w+", options.partition("members: [")[2].partition("]")[0]):
            assert hasattr(pkgutil.resolve_name(name), member)
