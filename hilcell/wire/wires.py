"""The wires of a device, by the options of its driver.

A wire has a name within its device: "" for ``channel``, or for ``host`` with ``port``; ``rtde`` for
``rtde_port``; ``strip`` for that of a part with a table of its own. A recording of a wire is named
by its device and itself: ``robot.wire.jsonl``, ``robot.rtde.wire.jsonl``.
"""

from __future__ import annotations

from collections.abc import Mapping

from hilcell.wire.channel import SerialLine, Socket, parse_channel

PORT = "port"


def wires_of(options: Mapping[str, object]) -> dict[str, Socket | SerialLine]:
    """Return where a device's wires lead, by name; a CAN interface of the kernel is left out."""
    found: dict[str, Socket | SerialLine] = {}
    host, channel = options.get("host"), options.get("channel")
    for key, value in options.items():
        if isinstance(value, Mapping):
            found |= {joined(key, name): place for name, place in wires_of(value).items()}
        elif isinstance(host, str) and isinstance(value, int) and _is_port(key):
            found[key.removesuffix(PORT).removesuffix("_")] = Socket(host, value)
    if isinstance(channel, str) and not is_can_interface(options):
        found[""] = parse_channel(channel)
    return found


def addressed(options: Mapping[str, object], channels: Mapping[str, str]) -> dict[str, object]:
    """Return the values of a driver's options with which its wires lead to ``channels``."""
    found: dict[str, object] = {}
    for name, channel in channels.items():
        part, place = options.get(name), parse_channel(channel)
        if isinstance(part, Mapping):
            found[name] = {**part, **addressed(part, {"": channel})}
        elif "host" in options and isinstance(place, Socket):
            found |= {"host": place.host, f"{name}_{PORT}".lstrip("_"): place.port}
        else:
            found["channel"] = channel
    return found


def is_can_interface(options: Mapping[str, object]) -> bool:
    """Whether the channel is an interface of the kernel, which no relay can stand before."""
    return options.get("interface") == "socketcan"


def can_interfaces(options: Mapping[str, object]) -> list[str]:
    """Return the CAN interfaces of the kernel that a device, or a part of it, is reached by."""
    parts = [part for part in options.values() if isinstance(part, Mapping)]
    return [str(part["channel"]) for part in (options, *parts) if is_can_interface(part)]


def joined(*names: str) -> str:
    """Return the name of a wire of a part, or among those of its cell."""
    return ".".join(filter(None, names))


def _is_port(key: str) -> bool:
    return key == PORT or key.endswith(f"_{PORT}")
