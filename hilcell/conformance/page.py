"""The table of docs/conformance.md, from the promises: ``python -m hilcell.conformance.page``.

Reads the page on stdin, and writes it with its table renewed.
"""

from __future__ import annotations

import sys

from hilcell.conformance.kit import PROMISES


def table() -> str:
    """Return one line a promise."""
    rows = [
        f"| `{each.name}` | {', '.join(each.ports)} | {each.sentence} | "
        f"{'yes' if each.real else 'no'} |"
        for each in PROMISES
    ]
    return "\n".join(["| promise | ports | in words | real devices |", "|---|---|---|---|", *rows])


def renewed(page: str) -> str:
    """Return a page with its table renewed."""
    begin, end = "<!-- promises: python -m hilcell.conformance.page -->", "<!-- end of promises -->"
    head, _, rest = page.partition(begin)
    _, _, tail = rest.partition(end)
    return f"{head}{begin}\n{table()}\n{end}{tail}"


if __name__ == "__main__":
    sys.stdout.write(renewed(sys.stdin.read()))
