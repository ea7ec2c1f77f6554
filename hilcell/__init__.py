"""hilcell calibrates a robot on a rail with a laser tracker, unattended.

For programs, ``import hilcell as hc`` has the names of `__all__`, which are stable; everything
else may change. Each is loaded where it is first used. The commands of ``hilcell`` call the same
functions.
"""

from importlib import import_module

__version__ = "0.1.0"
__all__ = [
    "HilcellError",
    "Measurements",
    "PoseCorrection",
    "Robot",
    "RobotFit",
    "Run",
    "UsableCalibration",
    "fit_robot",
    "load_cell",
    "open_calibration",
    "open_run",
    "ports",
    "read_measurements",
    "read_robot",
    "rigid_arm",
]
# The module of each name; `__init__.pyi` states the same for type checkers.
_MODULES = {
    "HilcellError": "hilcell.errors",
    "Measurements": "hilcell.fit.measurements",
    "PoseCorrection": "hilcell.programs.pose_correction",
    "Robot": "hilcell.fit.robot_file",
    "RobotFit": "hilcell.fit.methods",
    "Run": "hilcell.report.recorded",
    "UsableCalibration": "hilcell.programs.corrected",
    "fit_robot": "hilcell.fit.methods",
    "load_cell": "hilcell.cell.file",
    "open_calibration": "hilcell.programs.corrected",
    "open_run": "hilcell.report.recorded",
    "read_measurements": "hilcell.fit.measurements",
    "read_robot": "hilcell.fit.urdf_file",
    "rigid_arm": "hilcell.fit.rigid_arm",
}


def __getattr__(name: str) -> object:
    if name == "ports":
        return import_module("hilcell.ports")
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_MODULES[name]), name)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
