"""The script that the driver sends to a controller of Universal Robots, and the steps there."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import resources

from drivers.controller_steps import address, reflector, steps
from hilcell.ports import ControllerFile, ControllerSide

SCRIPT = "hilcell.script"
STEPS = """
Nothing is installed. Connect the PC{address} and enable RTDE, the secondary client and the
dashboard server in the security settings (TCP ports {ports}). Keep this network private: the
services have no password.

Enter the reflector's centre as the TCP{reflector}, without rotation, and its payload.

Must be free: input registers double 24 to 30 and int 24 to 28, output registers int 24 to 27 and
double 24 to 29.

Switch on, release the brakes and switch the panel to remote control. No other program may run.

Once, in a slow motion, unplug the PC's network cable: the robot must brake within two seconds.
"""


def shipped_script() -> str:
    return (resources.files("drivers.universal_robots") / "script" / SCRIPT).read_text("ascii")


def nothing_to_install(options: Mapping[str, object]) -> ControllerSide:
    """Return the script, to read only, and the steps."""
    usual = {"rtde_port": 30004, "script_port": 30002, "dashboard_port": 29999}
    ports = ", ".join(str(options.get(name, port)) for name, port in usual.items())
    filled = steps(STEPS, address=address(options), ports=ports, reflector=reflector(options))
    script = ControllerFile(SCRIPT, "", shipped_script().encode("ascii"))
    title = "Universal Robots controller by RTDE"
    return ControllerSide(title, "sent at each connect", [script], filled)
