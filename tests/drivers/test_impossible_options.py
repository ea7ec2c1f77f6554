"""Options that no device can have are refused with the cell file, before anything is opened."""

from __future__ import annotations

import pytest

from hilcell.cell.devices import check_options
from hilcell.cell.file import load_cell
from hilcell.cell.settings import SettingsError

CHANNEL, BITRATE = "rail.options.channel", "rail.options.bitrate"
STRIP = "rail.options.strip"


def strip(driver: str, channel: str, bitrate: str = "500000") -> dict[str, str]:
    return {STRIP: f'{{driver = "{driver}", channel = "{channel}", bitrate = {bitrate}}}'}


def robot(driver: str, **options: str) -> dict[str, str]:
    return {"robot.driver": driver} | {f"robot.options.{key}": v for key, v in options.items()}


def tracker(driver: str, **options: str) -> dict[str, str]:
    return {"tracker.driver": driver} | {f"tracker.options.{key}": v for key, v in options.items()}


def socketcan(name: str) -> dict[str, str]:
    return {"rail.options.interface": "socketcan", CHANNEL: name}


@pytest.mark.parametrize(
    ("key", "changed"),
    [
        *(("bitrate", {BITRATE: rate}) for rate in ("12345", "0", "-1")),
        *(("bitrate", strip("canopen", "socket://h:1", rate)) for rate in ("12345", "0", "-1")),
        *(
            ("channel", changed)
            for line in ("/dev/ttyS0@0", "/dev/ttyS0@4000001")
            for changed in (
                {CHANNEL: line}, strip("serial", line), tracker("leica-geocom", channel=line)
            )
        ),
        *(
            ("channel", {CHANNEL: name})
            for name in (
                "socket://h:0", "socket://h:65536", "socket://h:nan", "socket://:1",
                "socket://a b:1", "socket://h:1/x", "socket://me@h:1", "tcp://h:1",
            )
        ),
        *(("channel", socketcan(name)) for name in ("", "/dev/ttyS0", "a b", "x" * 16)),
        ("host", robot("kuka-c3", host="")),
        ("host", robot("kuka-eki", host=" ")),
        ("host", robot("ur-rtde", host="/dev/ttyS0")),
        ("web_services", {"robot.options.web_services": "3"}),
        ("certificate_sha256", {"robot.options.certificate_sha256": "xyz"}),
        ("egm_device", {"robot.options.egm_device": "a b"}),
        ("host", tracker("leica-emscon", host="10.0.0.1:7000")),
        ("host", tracker("t2sa", host="http://h")),
        ("port", robot("kuka-c3", port="0")),
        ("port", robot("kuka-eki", port="65536")),
        ("port", tracker("leica-emscon", port="nan")),
        ("port", tracker("t2sa", port="-1")),
        ("stop_port", robot("kuka-eki", port="54601")),  # its two ports differ
        ("strip_counts_per_mm", {"rail.options.strip_counts_per_mm": "1e300"}),
    ],
)  # fmt: skip
def test_an_impossible_option_is_refused_by_its_key(key: str, changed: dict[str, str]) -> None:
    of_abb = key in ("web_services", "certificate_sha256", "egm_device")
    cell = "abb" if of_abb else "lab" if changed.get("robot.driver") == "ur-rtde" else "paper"
    with pytest.raises(SettingsError) as error:
        check_options(load_cell(cell, changed))
    (problem,) = error.value.problems
    assert f"{key}: " in problem


@pytest.mark.parametrize(
    "changed",
    [
        *(
            {"tracker.options.host": host, "robot.options.host": host}
            for host in ("::1", "fe80::1%eth0", "10.0.0.1", "tracker-1.plant.example")
        ),
        socketcan("can0") | {BITRATE: "12345"},  # the kernel's interface has its own bit rate
    ],
)
def test_other_options_are_taken(changed: dict[str, str]) -> None:
    check_options(load_cell("paper", changed))
