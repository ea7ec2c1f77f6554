"""Packages beside hilcell, as their installation leaves them."""

from __future__ import annotations

from pathlib import Path


def install(site: Path, entry_points: str, name: str = "plant", **modules: str) -> None:
    """Put a package into ``site``: its metadata, and its modules by name."""
    metadata = site / f"{name}-1.dist-info"
    metadata.mkdir(parents=True)
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1\n")
    (metadata / "entry_points.txt").write_text(entry_points)
    for module, source in modules.items():
        (site / f"{module}.py").write_text(source)
