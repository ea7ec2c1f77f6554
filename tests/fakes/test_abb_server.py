"""A simulated ABB controller against clients that are not ours, and its habits."""

from __future__ import annotations

import contextlib
import hashlib
import http.client
import json
import socket
import ssl
import struct
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Iterator
from dataclasses import dataclass
from http.cookiejar import CookieJar
from typing import Any

import numpy as np
import pytest

from fakes.abb import server as abb_server
from fakes.abb.server import AbbServer, egm_robot
from fakes.site import Site
from hilcell.cell.file import load_cell
from tests.fakes.conftest import DeviceTime, simulated_site
from tests.fakes.rail_bench import until

SYMBOL = "/rw/rapid/symbol/data/RAPID/T_ROB1/hilcell"


@dataclass
class Robot:
    site: Site
    server: AbbServer

    @property
    def base(self) -> str:
        scheme = "http" if self.server.generation == 1 else "https"
        return f"{scheme}://127.0.0.1:{self.server.address['port']}"

    def client(self) -> urllib.request.OpenerDirector:
        """Return the standard library's client, with cookies and the login of the generation."""
        keys = urllib.request.HTTPPasswordMgrWithDefaultRealm()
        keys.add_password(None, self.base, "Default User", "robotics")
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
        return urllib.request.build_opener(
            urllib.request.ProxyHandler({}),
            urllib.request.HTTPSHandler(context=context),
            urllib.request.HTTPDigestAuthHandler(keys),
            urllib.request.HTTPBasicAuthHandler(keys),
            urllib.request.HTTPCookieProcessor(CookieJar()),
        )

    def get(self, client: urllib.request.OpenerDirector, path: str) -> Any:
        with client.open(self.base + path) as answer:
            return json.load(answer)

    def post(self, client: urllib.request.OpenerDirector, path: str, **form: str) -> int:
        data = urllib.parse.urlencode(form).encode()
        try:
            with client.open(self.base + path, data) as answer:
                return int(answer.status)
        except urllib.error.HTTPError as error:
            error.close()
            return error.code


@contextlib.contextmanager
def serving(generation: int = 1, speed: float = 50.0) -> Iterator[Robot]:
    cell = load_cell("abb", {"robot.options.web_services": str(generation)})
    site, _ = simulated_site(cell, speed)
    server = abb_server.serve(site, 0)
    with contextlib.closing(server):
        server.start()
        yield Robot(site, server)


@pytest.fixture
def robot() -> Iterator[Robot]:
    with serving() as robot:
        yield robot


def start(robot: Robot, client: urllib.request.OpenerDirector) -> None:
    pointer = "/rw/rapid/tasks/T_ROB1/pcp?action=set-pp-routine"
    assert robot.post(client, pointer, module="hilcell", routine="hc_main") == 204
    assert robot.post(client, "/rw/rapid/execution?action=start") == 204


def test_the_standard_library_logs_in_by_digest(robot: Robot) -> None:
    client = robot.client()
    found = robot.get(client, "/ctrl/identity?json=1")
    assert found["_embedded"]["_state"][0]["ctrl-id"] == "6700512345"
    robot.get(client, "/rw/panel/opmode?json=1")
    assert len(robot.server.sessions.open) == 1  # by its cookies
    port = robot.server.address["port"]
    assert isinstance(port, int)
    with contextlib.closing(http.client.HTTPConnection("127.0.0.1", port)) as stranger:
        stranger.request("GET", "/ctrl/identity")
        assert stranger.getresponse().status == 401


def test_the_second_generation_has_tls_and_its_own_json() -> None:
    with serving(2) as robot:
        found = robot.get(robot.client(), "/rw/panel/ctrl-state")
        assert found["state"][0]["ctrlstate"] == "motoron"
        port = robot.server.address["port"]
        assert isinstance(port, int)
        shown = ssl.get_server_certificate(("127.0.0.1", port))
        digest = hashlib.sha256(ssl.PEM_cert_to_DER_cert(shown)).hexdigest()
        assert digest == robot.server.address["certificate_sha256"]


def test_a_write_of_the_second_generation_needs_mastership() -> None:
    with serving(2) as robot:
        client = robot.client()
        path = "/rw/rapid/symbol/RAPID/T_ROB1/hilcell/hc_life/data"
        assert robot.post(client, path, value="5") == 403
        assert robot.post(client, path + "?mastership=implicit", value="5") == 204
        assert robot.post(client, "/rw/mastership/edit/request") == 204
        assert robot.post(client, path, value="6") == 204
        assert robot.post(robot.client(), path + "?mastership=implicit", value="7") == 403


def test_seventy_sessions(robot: Robot) -> None:
    robot.server.sessions.open |= {f"{n:x}" for n in range(69)}
    client = robot.client()
    robot.get(client, "/rw/panel/opmode?json=1")
    assert robot.post(robot.client(), "/rw/rapid/execution?action=stop") == 503
    with client.open(robot.base + "/logout"):
        pass
    robot.get(robot.client(), "/rw/panel/opmode?json=1")


def test_values_that_do_not_fit_are_refused(robot: Robot) -> None:
    client = robot.client()
    for name, value in (("hc_life", "TRUE"), ("hc_target", "[1,2]"), ("hc_target", "[[a],[9E9]]")):
        assert robot.post(client, f"{SYMBOL}/{name}?action=set", value=value) == 400
    assert robot.post(client, f"{SYMBOL}/hc_none?action=set", value="1") == 404


def test_without_a_sign_of_life_a_motion_is_stopped(device_time: DeviceTime, robot: Robot) -> None:
    client = robot.client()
    start(robot, client)
    robot.site.faults.set("robot.frozen")
    assert robot.post(client, f"{SYMBOL}/hc_order?action=set", value="1") == 204

    def state() -> list[str]:
        found = robot.get(client, f"{SYMBOL}/hc_state?json=1")
        value: str = found["_embedded"]["_state"][0]["value"]
        return value.strip("[]").split(",")

    assert state()[3:] == ["0", "0", "1"]
    while state()[3] == "0":
        device_time.at_s += 0.1
    assert state()[3:] == ["1", "8", "1"]


def test_golden_bytes_of_a_datagram() -> None:
    """By the field numbers of egm.proto, counted by hand."""
    joints = b"".join(b"\x09" + struct.pack("<d", each) for each in range(6))
    positions = b"\x0a\x36" + joints + b"\x22\x06" + b"\x08\x07" + b"\x10\xa0\xc2\x1e"
    expected = (
        b"\x0a\x07\x08\x05\x10\xcc\x3a\x18\x02"
         b"\x12\x40" + positions + b"\x1a\x40" + positions
        + b"\x22\x02\x08\x01" + b"\x2a\x02\x08\x02" + b"\x30\x00" + b"\x42\x02\x08\x02"
    )  # fmt: skip
    assert egm_robot(5, 7.5, np.arange(6.0), motors_on=True, running=True) == expected


def test_the_stream_runs_with_the_program(robot: Robot) -> None:
    client = robot.client()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as pc:
        pc.bind(("127.0.0.1", robot.server.stream.port))
        pc.settimeout(5.0)
        start(robot, client)
        numbers: list[int] = []
        while not numbers or numbers[-1] < 100:
            number, shift = 0, 0
            for byte in pc.recv(2048)[3:8]:  # behind the keys of header and number
                number |= (byte & 0x7F) << shift
                shift += 7
                if byte < 0x80:
                    break
            numbers.append(number)
        assert 97 not in numbers  # lost
        assert numbers.count(61) == 2  # doubled
        assert numbers.index(44) < numbers.index(43)  # late
        robot.server.controller.stop()
        pc.settimeout(0.0)
        until(lambda: not drained(pc))


def drained(pc: socket.socket) -> bool:
    """Whether a datagram waits; it is read."""
    try:
        pc.recv(2048)
    except BlockingIOError:
        return False
    return True
