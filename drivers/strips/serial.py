"""A magnetic strip's absolute sensor on a serial line, by the service commands of SIKO's sensors.

A command is a letter, with a figure where it has one, and no end of line; every answer ends with
``>`` and CR. ``A0``, ``A1``, ``A2``: type, firmware, serial number; ``Z``: position, ``+0110042>``;
``X``: system register, ``0x01>``; ``?`` refuses a command (MSAC501-S(RS485) and AP10S manuals).
An answer carries no mark of its question, so a line that missed one is not used again.
"""

from __future__ import annotations

import re
from collections.abc import Callable

from drivers.standing import DEVICE
from drivers.strips.strip import StripOptions
from drivers.supervision import Patience, on_failure
from drivers.wires.link import Link, open_link
from drivers.wires.tcp import Alarms
from drivers.wires.text_lines import TextLines
from hilcell.clean import clean
from hilcell.ports import (
    Clock,
    DeviceError,
    DeviceRefused,
    Identity,
    LinkStatistics,
    says_simulated,
)

REPLY_S = 0.3  # 11 characters at 4800 baud take 25 ms
ALARMS = Alarms(unreachable="HC-S11", lost="HC-S12")
POSITION = re.compile(r"[+-]\d{6,9}")
REGISTER = re.compile(r"0x[0-9a-fA-F]{2}")
_BITS = {
    0: "the head is too far from the strip",
    1: "the absolute value is not plausible",
    2: "the slide was too fast for the head",
    4: "the head is being adjusted",
    5: "wrong values in the sensor's memory",
    6: "wrong check sum in the sensor's memory",
    7: "the sensor's memory cannot be read",
}


class SerialStrip:
    """Satisfies `drivers.strips.strip.Strip`."""

    def __init__(self, options: StripOptions, clock: Clock) -> None:
        self._options, self._clock = options, clock
        self._check = clock.check  # in each wait of its wire
        self._link: Link | None = None
        self._lines: TextLines | None = None
        self._answers = self._bad = 0

    def connect(self) -> Identity:
        """Open the line and verify who answers."""
        self._answers = self._bad = 0
        self._check = self._clock.check
        self._link = open_link(DEVICE, self._options.channel, self._look, ALARMS)
        self._lines = TextLines(self._link, end=b"", split=rb"\r")
        with on_failure(self.close):
            self._lines.drop_pending()
            return self._identify(self._link.address)

    def read(self, check: Callable[[], None]) -> tuple[int, int]:
        """Return counts and alarms; the alarms are asked for after the counts."""
        self._check = check
        check()
        counts = int(self._ask("Z", POSITION))
        check()
        return counts, int(self._ask("X", REGISTER), 16)

    def alarm_text(self, alarms: int) -> str:
        """Return the bits of the system register in words."""
        bits = [bit for bit in range(16) if alarms >> bit & 1]
        return "; ".join(_BITS.get(bit, f"bit {bit} of its register") for bit in bits)

    def statistics(self) -> LinkStatistics:
        """Return the counts of answers, and of those in another form."""
        return LinkStatistics(frames=self._answers, bad_lines=self._bad)

    def close(self) -> None:
        """Close the line."""
        link, self._link, self._lines = self._link, None, None
        if link is not None:
            link.close()

    def _look(self) -> None:
        self._check()

    def _identify(self, address: str) -> Identity:
        model, firmware = self._ask("A0"), self._ask("A1")
        serial = self._ask("A2", re.compile(r"\d{1,10}")).lstrip("0")
        if self._options.serial and serial != str(self._options.serial):
            raise DeviceRefused(
                "HC-R08",
                DEVICE,
                "connect",
                f"strip sensor {serial}",
                wanted=f"{self._options.serial}",
                act="this is another sensor; correct rail.options.strip",
                fields={"serial": serial},
            )
        simulated = says_simulated(model)
        return Identity(DEVICE, model, serial, address, simulated, "strip", "", firmware)

    def _ask(self, command: str, form: re.Pattern[str] | None = None) -> str:
        """Return the answer to a command; raises `DeviceError` for none, or one of another form."""
        lines, link = self._lines, self._link
        if lines is None or link is None:
            raise DeviceError("HC-S12", DEVICE, "strip", "not connected", act="connect first")
        lines.send(command, command)
        answer = lines.receive(Patience(REPLY_S))
        if answer is None:
            raise link.broken(command, f"the strip sensor did not answer in {REPLY_S:.1f} s")
        text = answer.removesuffix(">")
        if text == answer or (form is not None and not form.fullmatch(text)):
            self._bad += 1
            raise DeviceError(
                "HC-S13",
                DEVICE,
                f"strip, command {command}",
                f"answer {clean(answer)[:40]!r}",
                act="is this the sensor and its baud rate? check rail.options.strip, resume",
                fields={"command": command},
            )
        self._answers += 1
        return clean(text)
