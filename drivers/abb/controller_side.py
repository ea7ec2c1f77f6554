"""The RAPID module of an ABB controller, filled in for one cell, and the steps of the person."""

from __future__ import annotations

import re
from collections.abc import Mapping
from importlib import resources

from drivers.controller_steps import address, reflector, steps
from hilcell.decoding import typed
from hilcell.ports import ControllerFile, ControllerSide

MODULE_FILE = "hilcell.mod"
MODULE_VERSION = 3
NO_LOAD_KG = 0.001  # mass of the controller's load0
UNFILLED = re.compile(r" *! TO BE FILLED IN: .*\n")
DEVICE = "UCdevice"
STEPS = """
Needed options: Externally Guided Motion (RobotWare 6: 689-1, RobotWare 7: 3124-1), and in RobotWare
6 PC Interface (616-1).

Connect the PC to the controller's WAN port{address}. Keep this network private.

In the system parameters, topic Communication, create the UDP unicast device `{device}` (RobotWare
6: Transmission Protocol of type UDPUC). Its remote address is the PC's, its remote port one that is
free on the PC, such as 6510. Restart the controller. Allow this UDP port in the PC's firewall.

Create a user for hilcell in the authorization system with the grants to read and write RAPID data,
to start and stop programs and to use web services. Write its password into a file that only you can
read, and name it in `robot.options.password_file`, or set HILCELL_ABB_PASSWORD.

Copy `hilcell.mod` to `HOME` and load it into task T_ROB1. Its tool `hc_tool` is the reflector's
centre on the flange{reflector}; enter the load that is really there: at a mass of 0.001 kg, as in
the file, nothing moves.{unfilled}

RobotWare 7: compare the certificate's SHA-256 fingerprint, which hilcell names, with the one that a
browser at the controller's service port shows, and write it to `robot.options.certificate_sha256`.

Switch to automatic, motors on, speed 100 %. hilcell starts the routine `hc_main` itself.

Once, in a slow motion, unplug the PC's network cable: the robot must brake within two seconds.
"""


def controller_side(options: Mapping[str, object]) -> ControllerSide:
    """Return the module with tool and stream's device of the options, and the steps."""
    device = str(options.get("egm_device", DEVICE))
    text = (resources.files("drivers.abb") / "rapid" / MODULE_FILE).read_text("ascii")
    text = text.replace(f'"{DEVICE}"', f'"{re.sub("[^A-Za-z0-9_]", "", device)}"')
    lacks = list[str]()
    if "smr_mm" in options:
        x, y, z = typed(options["smr_mm"], tuple[float, float, float])
        text = text.replace("[TRUE,[[0,0,0],", f"[TRUE,[[{x:.4f},{y:.4f},{z:.4f}],")
        text = UNFILLED.sub("", text)
    else:
        lacks.append("place of hc_tool in hilcell.mod, which is robot.smr_mm of the cell file")
    filled = steps(
        STEPS,
        address=address(options),
        device=device,
        reflector=reflector(options),
        unfilled=" **Not filled in without a cell:** " + lacks[0] + "." if lacks else "",
    )
    module = ControllerFile(MODULE_FILE, "HOME", text.encode("ascii"))
    version = f"hilcell.mod {MODULE_VERSION}"
    return ControllerSide("ABB controller by EGM", version, [module], filled, lacks)
