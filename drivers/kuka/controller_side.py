"""The files of a KUKA controller, filled in for one cell, and the steps of the person there."""

from __future__ import annotations

import re
from collections.abc import Mapping
from importlib import resources
from xml.sax.saxutils import escape

from drivers.controller_steps import address, reflector, steps
from drivers.kuka.controller import PROGRAM_VERSION
from hilcell.ports import ControllerFile, ControllerSide

PROGRAMS = r"KRC:\R1\Program"
ETHERNET_KRL = r"C:\KRC\ROBOTER\Config\User\Common\EthernetKRL"
NETWORK = """
Connect the PC to the controller's line interface{address} and open TCP {ports} in its network
configuration. Keep this network private: the interface has no password.
"""
SERVER = r"""
Install the variable server (C3 Bridge Interface Server, or KUKAVARPROXY) on the controller and
start it.

Copy `hilcell.src` and `hilcell.dat` to `KRC:\R1\Program`. If the server sees only `$config.dat`,
move the thirteen `DECL` lines of `hilcell.dat` there, below `USER GLOBALS`.
"""
DOCUMENTS = r"""
The option EthernetKRL 2.2 or later must be installed. Compare the address in both XML files
({host}) with that of the controller.

Copy the four KRL files to `KRC:\R1\Program` and the XML files to
`C:\KRC\ROBOTER\Config\User\Common\EthernetKRL`.

In `sps.sub` (`KRC:\R1\System`) add `HE_OPEN = FALSE` to the fold USER INIT and `HILCELL_EKI ( )`,
which does not block, to USER PLC.

Flags 910 and 911 must be free: search your programs for `$FLAG[910]` and `$FLAG[911]`. The
controller pings the PC every 5 s: allow it in the PC's firewall.

Cold-start the controller, so that it reads the XML files.
"""
START = """
Enter the reflector's centre on the flange as tool {tool}{reflector}; A, B and C are zero. Enter its
load. Base {base} is zero. Switch an absolute-accuracy model off.

Timer 10 must be free: search your programs for `$TIMER[10]`.

In T1 select `hilcell` and start it to block coincidence: the robot stays. Then switch to AUT or EXT
and start it again. It waits for the PC.

Once, in a slow motion, unplug the PC's network cable: the robot must brake within two seconds.
"""


def variable_server(options: Mapping[str, object]) -> ControllerSide:
    """Return files and steps for C3 Bridge or KUKAVARPROXY."""
    ports = f"port {options.get('port', 7000)}"
    return ControllerSide(
        "KUKA controller by C3 Bridge or KUKAVARPROXY",
        f"hilcell.src {PROGRAM_VERSION}",
        _motion_program(options),
        [
            *steps(NETWORK, address=address(options), ports=ports),
            *steps(SERVER),
            *_frames_and_start(options),
        ],
    )


def ethernet_krl(options: Mapping[str, object], documents: int) -> ControllerSide:
    """Return files and steps for the option EthernetKRL; ``documents`` is their version."""
    commands, stops = options.get("port", 54600), options.get("stop_port", 54601)
    host = str(options.get("host", "192.168.10.20"))
    files = _motion_program(options)
    for name in ("hilcell_eki.src", "hilcell_eki.dat"):
        files.append(ControllerFile(name, PROGRAMS, _shipped(f"eki_krl/{name}").encode("ascii")))
    for name, port in (("HilcellEki.xml", commands), ("HilcellStop.xml", stops)):
        text = _shipped(f"eki_krl/{name}")
        text = _replaced(text, r"<IP>[^<]*</IP>", f"<IP>{escape(host)}</IP>")
        text = _replaced(text, r"<PORT>\d+</PORT>", f"<PORT>{port}</PORT>")
        files.append(ControllerFile(name, ETHERNET_KRL, text.encode("ascii")))
    return ControllerSide(
        "KUKA controller by EthernetKRL",
        f"hilcell.src {PROGRAM_VERSION}, hilcell_eki.src {documents}",
        files,
        [
            *steps(NETWORK, address=address(options), ports=f"ports {commands} and {stops}"),
            *steps(DOCUMENTS, host=host),
            *_frames_and_start(options),
        ],
    )


def _frames_and_start(options: Mapping[str, object]) -> list[str]:
    tool, base = options.get("tool", 1), options.get("base", 0)
    return steps(START, tool=tool, base=base, reflector=reflector(options))


def _motion_program(options: Mapping[str, object]) -> list[ControllerFile]:
    """Return the resident program with the tool and base numbers of the options."""
    source = _shipped("krl/hilcell.src")
    for frame, usual in (("tool", 1), ("base", 0)):
        call = f"BAS (#{frame.upper()}, {options.get(frame, usual)})"
        source = _replaced(source, rf"BAS \(#{frame.upper()}, \d+\)", call)
    return [
        ControllerFile("hilcell.src", PROGRAMS, source.encode("ascii")),
        ControllerFile("hilcell.dat", PROGRAMS, _shipped("krl/hilcell.dat").encode("ascii")),
    ]


def _shipped(name: str) -> str:
    return (resources.files("drivers.kuka") / name).read_text("ascii")


def _replaced(text: str, pattern: str, new: str) -> str:
    """Return a text with its one match replaced."""
    changed, count = re.subn(pattern, lambda _: new, text)
    if count != 1:
        raise ValueError(f"expected one {pattern} in the shipped file, got {count}")
    return changed
