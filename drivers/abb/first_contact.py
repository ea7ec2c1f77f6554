"""An ABB controller before its first run: login, options, stream, settings, abilities; reads only.

Joint limits are system parameters of the topic Motion, type Arm: ``lower_joint_bound`` and
``upper_joint_bound`` in rad, of the instances rob1_1 to rob1_6 (3HAC050948, "System parameters").
"""

from __future__ import annotations

import math
import os
import re
import socket
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Literal

import numpy as np

from drivers.abb.controller_side import MODULE_VERSION, NO_LOAD_KG
from drivers.abb.http_channel import PORTS, Login, Trust
from drivers.abb.web_services import WebServices
from drivers.device_errors import ROBOT
from drivers.supervision import check_identity, ignore_stop
from hilcell.decoding import typed
from hilcell.geometry.frames import matrix
from hilcell.ports import (
    Ability,
    Array,
    Candidate,
    DeviceError,
    Identity,
    RobotSettings,
    is_simulated_name,
)
from hilcell.sanitize import clean

PASSWORD = "HILCELL_ABB_PASSWORD"  # environment variable
USER, USUAL_PASSWORD = "Default User", "robotics"  # of the maker
EGM = "Externally Guided Motion"


def login_of(user: str, password_file: str) -> Login:
    """Return a login with the password of a file, of the environment, or the maker's usual one."""
    if not password_file:
        return Login(user, os.environ.get(PASSWORD, USUAL_PASSWORD))
    try:
        return Login(user, Path(password_file).read_text("utf-8").strip())
    except (OSError, UnicodeDecodeError) as error:
        found = f"robot.options.password_file {password_file}: {error}"
        raise ROBOT.refused("HC-B80", "connect", found, expected="a text file") from error


@contextmanager
def opened(options: Mapping[str, object]) -> Iterator[WebServices]:
    """Open the web services by a driver's options, with their defaults; end the session after."""
    generation: Literal[1, 2] = typed(options.get("web_services", 1), Literal[1, 2])
    text = {name: str(options.get(name, "")) for name in ("certificate_sha256", "ca_file")}
    services = WebServices(
        generation,
        str(options["host"]),
        typed(options.get("port", PORTS[generation]), int),
        Trust(text["certificate_sha256"], text["ca_file"]),
        login_of(str(options.get("user", USER)), str(options.get("password_file", ""))),
        ignore_stop,
    )
    try:
        yield services
        with suppress(DeviceError):  # the session ends by itself
            services.log_out()
    finally:
        services.close()


def identity_of(services: WebServices) -> Identity:
    """Return the controller's id, the robot's type and the version of RobotWare.

    A virtual controller, which may have no id, counts as simulated.
    """
    states = services.states("/ctrl/identity")
    stated = {name: clean(value) for state in states for name, value in state.items()}
    serial = stated.get("ctrl-id", "")
    model = services.value("/rw/system/robottype", "robot-type")
    if "virtual" in stated.get("ctrl-type", "").casefold():
        model += " (virtual controller, simulated)"
    software = "RobotWare " + services.value("/rw/system", "rwversion")
    simulated = is_simulated_name(model)
    return Identity(
        ROBOT.name, model, serial, services.address, simulated, "robot", "ABB", software
    )


def check_type(identity: Identity, model: str, serial: str, name: str) -> str:
    """Return the robot's type; refuses another robot than the options' and than the cell file's.

    ``name`` is `robot.name`: it is compared where it begins with ``model``, so that it states a
    type; in letters and digits alone, as makers write types differently.
    """
    check_identity(identity.model, model, identity.serial, serial)
    stated, own, begin = (
        re.sub("[^a-z0-9]", "", each.casefold()) for each in (identity.model, name, model)
    )
    if begin and own.startswith(begin) and own not in stated:
        raise ROBOT.refused(
            "HC-B05",
            "connect",
            f"model {identity.model!r}",
            expected=f"{name!r}, which is robot.name of the cell file",
            model=identity.model,
        )
    return identity.model


def candidate(known: Mapping[str, object]) -> list[Candidate]:
    """Return the controller at ``known["host"]``, with why it cannot be used as its title."""
    host = known.get("host")
    if not isinstance(host, str):
        return []
    found = {name: known[name] for name in ("host", "port", "web_services") if name in known}
    try:
        with opened(known) as services:
            identity = identity_of(services)
    except DeviceError as error:
        if error.code == ROBOT.unreachable:
            return []
        return [Candidate(f"{host}: {error.found}", found, [])]
    model, serial = identity.model, identity.serial
    title = f"ABB {model}, controller {serial}, {identity.firmware}, at {host}"
    return [Candidate(title, {**found, "model": model, "serial": serial}, [identity])]


def controller_settings(services: WebServices) -> RobotSettings:
    identity = identity_of(services)
    return RobotSettings(
        identity.model, identity.serial, joint_limits(services), tool(services), None
    )


def joint_limits(services: WebServices) -> Array | None:
    """Return lower and upper limits (6, 2) in rad, None where they are not stated."""
    limits = []
    for axis in range(1, 7):
        try:
            found = services.attributes(f"/rw/cfg/MOC/ARM/instances/rob1_{axis}")
            limits.append([float(found[f"{end}_joint_bound"]) for end in ("lower", "upper")])
        except (DeviceError, KeyError, ValueError):
            return None
    limits_rad = np.array(limits)
    return limits_rad if bool(np.all(np.abs(limits_rad) <= 100.0)) else None


def tool(services: WebServices) -> Array | None:
    """Return the frame (4, 4) of hc_tool in the flange, None without the module."""
    try:
        found = services.symbol_numbers("hc_tool")
        return matrix(rotation(found[4:8]), np.array(found[1:4]))
    except (DeviceError, ValueError):
        return None


def abilities(
    services: WebServices, device: str, check_robot: Callable[[Identity], str]
) -> list[Ability]:
    """Return the table of all that the driver needs; ``check_robot`` refuses another robot."""
    identity = identity_of(services)

    def tried(
        feature: str,
        ask: Callable[[], object],
        needed: Literal["mandatory", "optional"] = "mandatory",
    ) -> Ability:
        try:
            return Ability(ROBOT.name, feature, "has", needed, str(ask()))
        except DeviceError as error:
            note = f"{error.found}; expected {error.expected}" if error.expected else error.found
            return Ability(ROBOT.name, feature, "has not", needed, note)

    rows = [
        Ability(ROBOT.name, "RobotWare", "has", "mandatory", identity.firmware),
        tried("robot type", lambda: check_robot(identity)),
        tried(f"option {EGM}", lambda: check_options(services)),
        tried(f"UDP unicast device {device}", lambda: f"to port {stream_port(services, device)}"),
        tried("module hilcell", lambda: check_module(services, device)),
        tried("event log", lambda: services.last_error()[1] or "no error", "optional"),
    ]
    limits = joint_limits(services)
    state: Literal["has", "has not"] = "has" if limits is not None else "has not"
    return [*rows, Ability(ROBOT.name, "joint limits", state, "optional")]


def check_module(services: WebServices, device: str) -> str:
    """Return the module's version.

    Refuses another one, one that streams to another device, or one whose tool has no load.
    """
    found = services.symbol_numbers("hc_version")
    if found != [float(MODULE_VERSION)]:
        raise ROBOT.refused(
            "HC-B17",
            "connect",
            f"hilcell.mod has version {found}",
            expected=str(MODULE_VERSION),
        )
    stated = services.symbol("hc_device").strip('"')
    if stated != device:
        raise ROBOT.refused(
            "HC-B85",
            "connect",
            f"hilcell.mod streams to UDP unicast device {stated}",
            expected=f"{device}, which is robot.options.egm_device",
            act="correct the option, or write and load the module again by `hilcell files`",
        )
    mass_kg = next(iter(services.symbol_numbers("hc_tool")[8:]), math.nan)
    if not mass_kg > NO_LOAD_KG:
        raise ROBOT.refused(
            "HC-B89",
            "connect",
            f"the load of hc_tool in hilcell.mod has a mass of {mass_kg:g} kg",
            expected=f"that of all that is mounted, above {NO_LOAD_KG:g} kg",
            mass_kg=mass_kg,
        )
    return f"version {MODULE_VERSION}"


def rotation(quaternion: Sequence[float]) -> Array:
    """Return the matrix (3, 3) of q1 .. q4, the real part first; raises `DeviceError`."""
    size = float(np.linalg.norm(quaternion))
    if not abs(size - 1.0) <= 1e-3:
        raise ROBOT.failed(
            "HC-B26", "read", f"a quaternion of length {size:g}", expected="1", length=size
        )
    w, x, y, z = np.array(quaternion) / size
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def check_options(services: WebServices) -> str:
    """Return the option that streams positions; refuses a controller without it."""
    names = [clean(s["option"]) for s in services.states("/rw/system") if "option" in s]
    if not names:
        names = [s["option"] for s in services.states("/rw/system/options") if "option" in s]
    for name in names:
        if EGM.casefold() in name.casefold():
            return name
    raise ROBOT.refused(
        "HC-B82",
        "connect",
        f"{services.address} has no option {EGM} among {len(names)}",
        expected="689-1 (RobotWare 6) or 3124-1 (RobotWare 7)",
    )


def absolute_accuracy(services: WebServices) -> bool:
    """Whether the controller computes with the links that were measured on this arm."""
    return services.value("/rw/motionsystem", "absacc-active").upper() in ("ON", "TRUE", "1")


def own_address(host: str) -> str:
    """Return this PC's address towards a host; sends nothing."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as towards:
        towards.connect((host, 9))  # of a UDP socket: sets its ends alone
        address: str = towards.getsockname()[0]
        return address


def stream_port(services: WebServices, device: str) -> int:
    """Return the PC's UDP port that the controller streams to, by its system parameters.

    Refuses a device that does not exist, and a remote address that is not this PC's.
    """
    kind = "COM_TRP" if services.generation == 1 else "UDPUC_HOST"
    instances = f"/rw/cfg/SIO/{kind}/instances"
    try:
        found = services.attributes(f"{instances}/{device}")
    except DeviceError as error:
        if error.code != "HC-B03":
            raise
        names = services.instances(instances)
        raise ROBOT.refused(
            "HC-B85",
            "connect",
            f"the UDP unicast devices of the controller are {', '.join(names) or 'none'}",
            expected=f"{device}, which is robot.options.egm_device",
            act="correct the option, or create the device and restart the controller",
        ) from error
    host = next((v for name, v in found.items() if name.startswith("RemoteAd")), "")
    port = next((v for name, v in found.items() if name.startswith("RemotePort")), "")
    if not port.isdecimal() or not 0 < int(port) < 65536:
        raise ROBOT.refused(
            "HC-B85",
            "connect",
            f"UDP unicast device {device} has the remote port {port!r}",
            expected="the port of this PC for the position stream",
        )
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as own:
        try:
            own.bind((host, 0))
        except OSError:
            raise ROBOT.refused(
                "HC-B85",
                "connect",
                f"UDP unicast device {device} streams to {host!r}",
                expected=f"{own_address(services.host)}, the address of this PC",
                act="correct the remote address in the system parameters, or robot.options."
                "egm_device, and restart the controller",
            ) from None
    return int(port)
