"""Packages beside hilcell, as their installation leaves them."""

from __future__ import annotations

from pathlib import Path

# A whole driver of a robot; its simulated device is none.
WHOLE = """
import msgspec

class Robot:
    class Options(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
        host: str
        lever_mm: float = 1.0

    def __init__(self, options, clock): ...
    def connect(self): ...
    def move_to(self, joints_rad, speed_percent): ...
    def read(self): ...
    def stop(self): ...
    def close(self): ...

def serve(site, port): ...
"""
ENTRIES = "[hilcell.robots]\nmine = {0}:Robot\n[hilcell.simulated_robots]\nmine = {0}:serve\n"


def install(site: Path, entry_points: str, name: str = "plant", **modules: str) -> None:
    """Put a package into ``site``: its metadata, and its modules by name."""
    metadata = site / f"{name}-1.dist-info"
    metadata.mkdir(parents=True)
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1\n")
    (metadata / "entry_points.txt").write_text(entry_points)
    for module, source in modules.items():
        (site / f"{module}.py").write_text(source)
