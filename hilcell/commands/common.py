"""Answers of commands: one JSON object on stdout, or words on stderr."""

from __future__ import annotations

from collections.abc import Mapping

import msgspec

from hilcell.commands.messages import tell


def say(values: Mapping[str, object], words: str, *, as_json: bool) -> None:
    """Print ``values`` as JSON where asked for, ``words`` otherwise."""
    if as_json:
        print(msgspec.json.encode(values).decode())
    else:
        tell(words)
