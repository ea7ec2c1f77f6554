"""A page as a browser's parser sees it, without a browser."""

from __future__ import annotations

from collections import Counter
from html.parser import HTMLParser

VOID = {"meta", "link", "br", "hr", "img", "input"}
LINKS = {"src", "href", "xlink:href", "srcset", "action", "data", "poster", "background"}


class Page(HTMLParser):
    """Tags, ids, links, styles and text of one page; unbalanced tags are an error."""

    def __init__(self, html: str) -> None:
        super().__init__(convert_charrefs=True)
        self.tags: Counter[str] = Counter()
        self.ids: list[str] = []
        self.links: list[str] = []
        self.attributes: list[tuple[str, str]] = []
        self.texts: list[tuple[str, str]] = []
        self._open: list[str] = []
        self._tables: dict[str, list[list[str]]] = {}
        self.feed(html)
        self.close()
        assert self._open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags[tag] += 1
        for name, value in attrs:
            self.attributes.append((name, value or ""))
            if name == "id":
                self.ids.append(value or "")
            if name in LINKS:
                self.links.append(value or "")
        if tag not in VOID:
            self._open.append(tag)
        if tag == "tr" and self._tables:
            self._rows().append([])
        if tag in ("td", "th") and self._tables:
            self._rows()[-1].append("")

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.handle_endtag(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self._open, f"</{tag}> closes nothing"
        assert self._open.pop() == tag

    def handle_data(self, data: str) -> None:
        inside = self._open[-1:]
        if inside == ["h3"]:
            self._tables[data] = []
        if inside in (["td"], ["th"]) and self._tables:
            self._rows()[-1][-1] += data
        if data.strip():
            self.texts.append((self._open[-1] if self._open else "", data.strip()))

    def _rows(self) -> list[list[str]]:
        """The rows of the table whose title came last."""
        return self._tables[next(reversed(self._tables))]

    def table(self, title: str) -> list[dict[str, str]]:
        """The rows of the table with this title, each cell by its column's header."""
        headers, *rows = self._tables[title]
        return [dict(zip(headers, row, strict=False)) for row in rows]

    @property
    def text(self) -> str:
        """Everything a reader sees."""
        return " ".join(text for tag, text in self.texts if tag != "style")

    def of(self, tag: str) -> list[str]:
        """The texts that stand directly in ``tag``."""
        return [text for inside, text in self.texts if inside == tag]
