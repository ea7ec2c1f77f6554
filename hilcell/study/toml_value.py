"""Values written as TOML in one line, as settings of a cell are given."""

from __future__ import annotations

import json
from collections.abc import Mapping


def toml_value(value: object) -> str:
    """Return a value that TOML or JSON has read, as TOML in one line."""
    if isinstance(value, Mapping):
        inner = (f"{json.dumps(str(key))} = {toml_value(each)}" for key, each in value.items())
        return f"{{ {', '.join(inner)} }}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(toml_value, value))}]"
    if isinstance(value, float):
        return repr(value)  # "inf" and "nan" too, which the cell refuses
    return json.dumps(value)
