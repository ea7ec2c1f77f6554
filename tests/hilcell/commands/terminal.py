"""A terminal with an encoding of its own, in place of this process's streams."""

from __future__ import annotations

import io
import sys

import pytest


class Terminal:
    """Both streams of a process, in one encoding, strict as stdout is in most locales."""

    def __init__(self, encoding: str, monkeypatch: pytest.MonkeyPatch) -> None:
        self.encoding = encoding
        self.streams = {
            name: io.TextIOWrapper(io.BytesIO(), encoding=encoding) for name in ("stdout", "stderr")
        }
        for name, stream in self.streams.items():
            monkeypatch.setattr(sys, name, stream)

    def read(self, name: str) -> str:
        stream = self.streams[name]
        stream.flush()
        stream.seek(0)
        return stream.buffer.read().decode(self.encoding)
