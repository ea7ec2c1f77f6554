"""Points of journals that hold no identities: they are read from the keys.

This is the only place where a key is parsed. A key of no known form keeps all that follows its
kind as the target.
"""

from __future__ import annotations

import re
from typing import Any

from hilcell.journal.point_id import PointId

_FORMS = [
    re.compile(form)
    for form in (
        r"(?P<kind>world)/(?P<nest>.+)",
        r"(?P<kind>control)/(?P<session>\d+)-(?P<turn>\d+)/(?P<nest>.+)",
        r"(?P<kind>slide|three|six)/(?P<station>.+)/(?P<nest>[^/]+)",
        r"(?P<kind>base)/axis(?P<axis>\d)/(?P<number>\d+)",
        r"(?P<kind>frames)/(?P<station>.+)/axis(?P<axis>\d)/(?P<number>\d+)",
        r"(?P<kind>grid)/(?P<vertex>\d+-\d+-\d+)",
        r"(?P<kind>repeatability)/(?P<place>\d+)/(?P<number>\d+)",
        r"(?P<kind>sign)/(?P<how>[^/]+)",
        r"(?P<kind>validate)/(?P<station>.+)/(?P<how>[^/]+)/(?P<number>\d+)",
        r"(?P<kind>survey)/(?P<way>[^/]+)/(?P<number>\d+)/(?P<nest>.+)",
        r"(?P<kind>repeat)/(?P<how>[^/]+)/(?P<way>[^/]+)/(?P<number>\d+)(?P<side>[+-])",
        r"(?P<kind>campaign)/(?P<pose>[^/]+)/(?P<target>.+)",
    )
]


def id_of_key(key: str) -> PointId:
    """Return the identity that a key was formatted from."""
    for form in _FORMS:
        if match := form.fullmatch(key):
            found = PointId(
                **{name: _value(name, text) for name, text in match.groupdict().items()}
            )
            if found.key == key:
                return found
    kind, _, rest = key.partition("/")
    return PointId(kind, target=rest)


def _value(name: str, text: str) -> Any:
    match name:
        case "vertex":
            return tuple(int(each) for each in text.split("-"))
        case "side":
            return int(f"{text}1")
        case "session" | "turn" | "place" | "axis" | "number":
            return int(text)
    return text
