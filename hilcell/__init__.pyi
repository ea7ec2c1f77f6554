# The names of the library for type checkers; at run time each is loaded where it is first used.
from hilcell import ports as ports
from hilcell.cell.file import load_cell as load_cell
from hilcell.errors import HilcellError as HilcellError
from hilcell.fit.measurements import Measurements as Measurements
from hilcell.fit.measurements import read_measurements as read_measurements
from hilcell.fit.methods import RobotFit as RobotFit
from hilcell.fit.methods import fit_robot as fit_robot
from hilcell.fit.rigid_arm import rigid_arm as rigid_arm
from hilcell.fit.robot_file import Robot as Robot
from hilcell.fit.urdf_file import read_robot as read_robot
from hilcell.programs.corrected import UsableCalibration as UsableCalibration
from hilcell.programs.corrected import open_calibration as open_calibration
from hilcell.programs.pose_correction import PoseCorrection as PoseCorrection
from hilcell.report.recorded import Run as Run
from hilcell.report.recorded import open_run as open_run

__version__: str
__all__: list[str]
