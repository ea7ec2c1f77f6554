"""Values written as TOML in one line, as settings of a cell are given."""

from __future__ import annotations

import json
from collections.abc import Mapping
from datetime import date, time


def toml_value(value: object) -> str:
    """Return a value that TOML or JSON has read, as TOML in one line."""
    if isinstance(value, Mapping):
        inner = (f"{_quoted(str(key))} = {toml_value(each)}" for key, each in value.items())
        return f"{{ {', '.join(inner)} }}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(toml_value, value))}]"
    if isinstance(value, float):
        return repr(value)  # "inf" and "nan" too, which the cell refuses
    if isinstance(value, date | time):
        return value.isoformat()
    return _quoted(value) if isinstance(value, str) else json.dumps(value)


def _quoted(text: str) -> str:
    """Return a string; TOML knows no halves of a character, and no bare DEL."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
