"""Look into a run.

    python docs/tutorials/look_into_a_run.py

It opens the journal of a run: points, frames, verdicts, result, and tables as data frames. First it
calibrates a simulated cell, which takes some seconds, as `hilcell run calibrate --unattended` does.
Data frames need pandas (`pip install '.[pandas]'`).
"""

# %%
from __future__ import annotations

import subprocess
import sys
import tempfile
from collections import Counter

import numpy as np

import hilcell as hc

# %% [markdown]
# A small calibration of the built-in cell: fewer points of each kind than a real one has.

# %%
SETTINGS = {
    "grid.pitch_mm": "450.0",
    "validation.per_cell": "1",
    "validation.others": "8",
    "base_frame.points": "6",
    "layout.nest_samples": "2",
    "sweeps.enabled": "false",
    "validation.mean_tolerance_mm": "0.3",
    "validation.max_tolerance_mm": "1.0",
}
runs = tempfile.TemporaryDirectory()
command = [sys.executable, "-m", "hilcell", "run", "calibrate", "--cell", "paper", "--unattended"]
command += ["--full", "--seed", "1", "--name", "tutorial", "--runs", runs.name]
for key, value in SETTINGS.items():
    command += ["--set", f"{key}={value}"]
subprocess.run(command, check=True, capture_output=True)

# %% [markdown]
# A run is opened by its name, or by its folder. Its journal is verified, and the result is computed
# from it again.

# %%
run = hc.open_run("tutorial", runs.name)
print(f"run {run.name}: {run.procedure} of cell {run.cell.name}, {run.state}")
kinds = Counter(point.id.kind for point in run.points.values())
print(f"{len(run.points)} points:", ", ".join(f"{n} {kind}" for kind, n in kinds.most_common(4)))

# %% [markdown]
# Points are raw readings in the tracker's frame. Frames are 4 x 4 matrices in {W}, mm. So a reading
# is taken into the world frame by `world`, the frame of the tracker.

# %%
point = run.points["grid/0-0-0"]
in_world_mm = run.frames["world"].T @ [*point.xyz_mm, 1.0]
print(f"grid/0-0-0 at {np.round(in_world_mm[:3], 2)} mm in {{W}}, the slide at {point.strip_mm} mm")
print(f"base of the robot: {np.round(run.frames['base'].T[:3, 3], 2)} mm in {{W}}")

# %% [markdown]
# Each verdict has an outcome, and figures with their limits.

# %%
for key, verdict in run.verdicts.items():
    print(f"  {key:18} {verdict.outcome.value:10} {verdict.text.splitlines()[0][:60]}")
judged = run.result["validation"]["S1100"]
before_mm, after_mm = judged["before"]["mean"], judged["chosen"]["mean"]
print(f"mean error at S1100: {before_mm:.2f} mm as sent, {after_mm:.2f} mm corrected")

# %% [markdown]
# The tables of `hilcell export xlsx` as data frames; the names of columns end in their unit.

# %%
print("tables:", ", ".join(run.tables))
points = run.data_frame("points")
validated = points[points["group"].str.startswith("validate")]
print(validated.groupby(["group", "station"])["error_mm"].agg(["count", "mean", "max"]).round(3))

# %% [markdown]
# The calibration that the run wrote corrects targets: x, y, z in mm and Z-Y-X angles in degrees,
# in {W}. `open_calibration` refuses one that is revoked, superseded, too old or out of tolerance.

# %%
used = hc.open_calibration("tutorial", runs.name)
target = np.array([[0.0, 0.0, 1250.0, 0.0, 75.0, 0.0]])
corrected = used.corrected("S1100", ["A1"], target)
print("command - target:", np.round((corrected.command - target)[0, :3], 3), "mm")
print(corrected.summary)
runs.cleanup()
