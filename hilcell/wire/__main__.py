"""``python -P -m hilcell.wire``: relay and record the wires of an order until stdin ends."""

from __future__ import annotations

import sys

import msgspec

from hilcell.typed import decoded
from hilcell.wire.relay import WireOrder, serve


def main() -> None:
    """Read the order from stdin, print the channels, and serve."""
    orders = decoded(sys.stdin.buffer.readline(), list[WireOrder])

    def until_ended(channels: dict[str, str]) -> None:
        sys.stdout.buffer.write(msgspec.json.encode(channels) + b"\n")
        sys.stdout.buffer.flush()
        sys.stdin.buffer.read()

    serve(orders, until_ended)


if __name__ == "__main__":
    main()
