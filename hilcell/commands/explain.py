"""``explain``: the meaning of an alarm's code, and the steps to take."""

from __future__ import annotations

import re
from difflib import get_close_matches

from hilcell.alarms.catalogue import Entry, catalogue
from hilcell.commands.orders import Explain
from hilcell.commands.output import print_data, print_json
from hilcell.errors import HilcellError

NEAREST = 3


def explain(args: Explain) -> int:
    """Print one entry of the catalogue."""
    entry = _entry(args.code)
    facts = {"code": entry.code, "title": entry.title, "means": entry.means, "do": entry.do}
    if args.json:
        print_json(facts)
    else:
        steps = (f"  {number}. {step}" for number, step in enumerate(entry.do, start=1))
        print_data("\n".join([f"{entry.code} {entry.title}", entry.means, *steps]))
    return 0


def _entry(code: str) -> Entry:
    """Return the entry; raises `HilcellError` with the codes that are most like an unknown one."""
    known = catalogue()
    named = re.sub(r"^HC(?=[A-Z])", "HC-", code.upper())
    if named in known:
        return known[named]
    nearest = ", ".join(get_close_matches(code.upper(), known, NEAREST, 0.0))
    raise HilcellError(f"alarm {code[:80]!r} is unknown; the nearest known: {nearest}")
