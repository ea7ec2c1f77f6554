"""Robot Web Services of both generations: state, identity, RAPID data, start and stop.

Generation 1 (RobotWare 6, IRC5): HTTP with digest login, 3HAC050973 "Robot Web Services"; actions
are queries, as ``/rw/rapid/execution?action=start``. Generation 2 (RobotWare 7, OmniCore): HTTPS
with basic login, 3HAC073675; actions are paths, as ``/rw/rapid/execution/start``, and the media
type has the version. Both answer in JSON here: objects with ``_type`` and ``_title`` whose values
are text, in ``_embedded._state`` or ``state``. An error has a code and a text in ``status``.

A write takes the mastership for its own duration ("taken internally on behalf of the client" in
generation 1, ``mastership=implicit`` in generation 2), so a PC that dies does not keep it.
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any
from urllib.parse import quote, urlencode

import msgspec

from drivers.abb.http_channel import Answer, HttpChannel, Login, Trust, other_generation
from drivers.device_errors import ROBOT
from drivers.supervision import polls
from hilcell.ports import DeviceError
from hilcell.sanitize import clean

State = Mapping[str, str]
TASK, MODULE = "T_ROB1", "hilcell"
FORBIDDEN, NOT_FOUND, BUSY = 403, 404, 503
HEADERS: Mapping[int, Mapping[str, str]] = {
    1: {"Accept": "application/json", "Connection": "keep-alive"},
    2: {"Accept": "application/hal+json;v=2.0", "Connection": "keep-alive"},
}
FORM = {1: "application/x-www-form-urlencoded", 2: "application/x-www-form-urlencoded;v=2.0"}
START = {
    "regain": "clear",
    "execmode": "continue",
    "cycle": "once",
    "condition": "none",
    "stopatbp": "disabled",
    "alltaskbytsp": "false",
}


class WebServices:
    """One connection to a controller's web services, in the session of its login."""

    BUSY_S = 3.0  # wire deadline: a controller that has too much to do
    AGAIN_S = 0.2
    STEP_S = 0.5

    def __init__(
        self,
        generation: int,
        host: str,
        port: int,
        trust: Trust,
        login: Login,
        check: Callable[[], None],
    ) -> None:
        self.generation, self.host, self._check = generation, host, check
        self._channel = HttpChannel(
            host, port, trust if generation > 1 else None, login, HEADERS[generation], check
        )
        self.address = self._channel.address

    def close(self) -> None:
        self._channel.close()

    # -- reading ------------------------------------------------------------------------------

    def states(self, path: str) -> list[State]:
        """Return the objects of a resource, with the values that are text."""
        answer = self._ask("GET", path)
        try:
            return list(_objects(decoded(answer.body)))
        except (msgspec.DecodeError, RecursionError) as error:
            raise self._invalid(path, f"no JSON: {answer.body[:60]!r}") from error

    def value(self, path: str, name: str) -> str:
        """Return the first value of this name; raises `DeviceError` where there is none."""
        for state in self.states(path):
            if name in state:
                return clean(state[name])
        raise self._invalid(path, f"no {name!r} in the answer")

    def operation_mode(self) -> str:
        return self.value("/rw/panel/opmode", "opmode")

    def controller_state(self) -> str:
        path = "/rw/panel/ctrlstate" if self.generation == 1 else "/rw/panel/ctrl-state"
        return self.value(path, "ctrlstate")

    def speed_ratio(self) -> float:
        """Return the speed ratio in percent; NaN where it is no number."""
        return _number(self.value("/rw/panel/speedratio", "speedratio"))

    def program_runs(self) -> bool:
        return self.value("/rw/rapid/execution", "ctrlexecstate") == "running"

    def numbers(self, path: str, *names: str) -> list[float]:
        """Return values that are finite numbers; raises `DeviceError`."""
        for state in self.states(path):
            if set(names) <= set(state):
                found = [_number(state[name]) for name in names]
                if not all(map(math.isfinite, found)):
                    shown = [clean(state[name]) for name in names]
                    raise self._invalid(path, f"{shown}, finite numbers are expected")
                return found
        raise self._invalid(path, f"no {', '.join(names)} in the answer")

    def symbol(self, name: str) -> str:
        """Return the value of RAPID data of the module as RAPID writes it."""
        return self.value(self._symbol_path(name), "value")

    def symbol_numbers(self, name: str) -> list[float]:
        """Return the numbers of RAPID data in their order; NaN for TRUE and FALSE."""
        text = self.symbol(name)
        pieces = [each.strip() for each in re.sub(r"[\[\]]", " ", text).split(",")]
        return [math.nan if each in ("TRUE", "FALSE") else _number(each) for each in pieces]

    def last_error(self) -> tuple[int, str]:
        """Return the newest error of the event log, its place in it and its text; 0 and "" if none.

        The text is the event's number and title, as "event 50027: Joint Out of Range".
        """
        least = "&limit=50" if self.generation > 1 else ""  # of 1000; generation 1 sends all
        for entry in self.states(f"/rw/elog/0?lang=en&order=lifo{least}"):
            error = "3"
            if entry.get("msgtype") == error and "code" in entry:
                place = re.search(r"(\d{1,9})$", entry.get("_title", ""))
                text = f"event {clean(entry['code'])}: {clean(entry.get('title', ''))}"
                return int(place[1]) if place else 0, text
        return 0, ""

    def attributes(self, path: str) -> dict[str, str]:
        """Return the attributes of an instance of system parameters by their names."""
        return {
            state["_title"]: clean(state["value"])
            for state in self.states(path)
            if {"_title", "value"} <= set(state)
        }

    def instances(self, path: str) -> list[str]:
        """Return the names of the instances of a type of system parameters."""
        kind = "cfg-dt-instance"
        states = self.states(path)
        return [clean(s["_title"]) for s in states if s.get("_type", "").startswith(kind)]

    # -- writing ------------------------------------------------------------------------------

    def set_symbol(self, name: str, value: str) -> None:
        path = self._symbol_path(name)
        self._post(self._action(path, "set") if self.generation == 1 else path, {"value": value})

    def request_mastership(self) -> None:
        """Take the right to edit; raises `DeviceRefused` where another holds it."""
        self._post(self._action(self._mastership, "request"), implicit=False)

    def release_mastership(self) -> None:
        self._post(self._action(self._mastership, "release"), implicit=False)

    def set_program_pointer(self, routine: str) -> None:
        form = {"module": MODULE, "routine": routine, "userlevel": "FALSE"}
        action = "set-pp-routine" if self.generation == 1 else "routine"
        self._post(self._action(f"/rw/rapid/tasks/{TASK}/pcp", action), form, implicit=False)

    def start(self) -> None:
        self._post(self._action("/rw/rapid/execution", "start"), START)

    def stop(self) -> None:
        self._post(*self._stop)

    def send_stop(self) -> None:
        """Send the stop without awaiting its answer; any thread."""
        path, form = self._stop
        self._channel.send("POST", self._complete(path), urlencode(form).encode(), self._form)

    def log_out(self) -> None:
        """End the session: a controller has 70 of them."""
        self._ask("GET", "/logout")

    # -- requests -----------------------------------------------------------------------------

    @property
    def _form(self) -> str:
        return FORM[self.generation]

    @property
    def _stop(self) -> tuple[str, Mapping[str, str]]:
        form = {"stopmode": "stop", "usetsp": "normal"}
        return self._action("/rw/rapid/execution", "stop"), form

    @property
    def _mastership(self) -> str:
        return f"/rw/mastership/{'rapid' if self.generation == 1 else 'edit'}"

    def _action(self, path: str, action: str) -> str:
        return f"{path}?action={action}" if self.generation == 1 else f"{path}/{action}"

    def _symbol_path(self, name: str) -> str:
        symbol = f"RAPID/{TASK}/{MODULE}/{quote(name)}"
        if self.generation == 1:
            return f"/rw/rapid/symbol/data/{symbol}"
        return f"/rw/rapid/symbol/{symbol}/data"

    def _complete(self, path: str, *, implicit: bool = True) -> str:
        """Return a path with what the generation needs besides."""
        if self.generation > 1:
            return f"{path}?mastership=implicit" if implicit else path
        return f"{path}{'&' if '?' in path else '?'}json=1"

    def _post(
        self, path: str, form: Mapping[str, str] | None = None, *, implicit: bool = True
    ) -> None:
        self._ask("POST", path, form or {}, implicit=implicit)

    def _ask(
        self,
        method: str,
        path: str,
        form: Mapping[str, str] | None = None,
        *,
        implicit: bool = True,
    ) -> Answer:
        """Return a good answer; raises `DeviceError` for others."""
        if form is None:
            kind, whole = "", path if self.generation > 1 else self._complete(path)
        else:
            kind, whole = self._form, self._complete(path, implicit=implicit)
        body = urlencode(form or {}).encode()
        for _ in polls(self.BUSY_S, self.STEP_S):
            answer = self._channel.ask(method, whole, body, kind)
            if answer.status != BUSY:
                break
            again_s = time.monotonic() + self.AGAIN_S
            while time.monotonic() < again_s:
                self._check()
                time.sleep(0.01)
        if not 200 <= answer.status < 300:
            raise self._refusal(f"{method} {path.partition('?')[0]}", answer)
        return answer

    def _refusal(self, operation: str, answer: Answer) -> DeviceError:
        found = f"{self.address}: {operation} has the answer {answer.status}{_status(answer.body)}"
        if answer.status == BUSY:
            act = "end other clients of the controller's web services; a session ends after minutes"
            return ROBOT.failed("HC-B87", "use", found, expected="a free session", act=act)
        if answer.status == FORBIDDEN:
            if holder := self.holder():  # first: a long text is cut at its end
                found = f"{holder}: {found}"
                return ROBOT.refused("HC-B83", "write", found, expected="nobody, or hilcell")
            return ROBOT.failed("HC-B03", "use", found, expected="200 or 204")
        if answer.status == NOT_FOUND and "/rw/panel/" in operation:
            signs = f"{operation} has the answer {answer.status}"
            return other_generation(self.address, signs, 3 - self.generation)
        if answer.status == NOT_FOUND and "/symbol" in operation:
            expected = f"module {MODULE} in task {TASK}"
            return ROBOT.refused("HC-B86", "use", found, expected=expected)
        return ROBOT.failed("HC-B03", "use", found, expected="200 or 204")

    def holder(self) -> str:
        """Return which other client has the mastership, as the controller states it; "" for none.

        3HAC050973, "Get Mastership Domain": nomaster, local (the pendant), remote or internal;
        names may be empty. ABB's App SDK reads the same of generation 2.
        """
        try:
            states = self.states(self._mastership)
        except DeviceError as error:
            return f"a client that is not known has the mastership ({error.found})"
        for state in states:
            kind = clean(state.get("mastership", "nomaster"))
            own = state.get("mastershipheldbyme", "").upper() == "TRUE"
            if kind != "nomaster" and not own:
                names = ("application", "location", "alias", "uid")
                named = [f"{name} {clean(state[name])}" for name in names if state.get(name)]
                return f"a {kind} client has the mastership ({', '.join(named) or 'not named'})"
        return ""

    def _invalid(self, path: str, found: str) -> DeviceError:
        where = f"{self.address}{path.partition('?')[0]}"
        return ROBOT.failed("HC-B26", "read", f"{where}: {found}", expected="the resource's values")


def decoded(body: bytes) -> Any:
    """Return JSON; RobotWare 7.20 writes arguments of events as ``-01``, which is none."""
    try:
        return msgspec.json.decode(body)
    except msgspec.DecodeError:
        return msgspec.json.decode(re.sub(rb"(:\s*-?)0+(?=\d)", rb"\1", body))


def _objects(value: Any, depth: int = 0) -> Iterator[State]:
    """Yield each object within a decoded answer, outermost first, with its values as text."""
    deepest = 12
    if depth > deepest:
        return
    if isinstance(value, dict):
        yield {k: str(each) for k, each in value.items() if isinstance(each, str | int | float)}
        for each in value.values():
            yield from _objects(each, depth + 1)
    elif isinstance(value, list):
        for each in value:
            yield from _objects(each, depth + 1)


def _number(text: str) -> float:
    """Return a number, NaN where it is none."""
    try:
        return float(text)
    except ValueError:
        return math.nan


def _status(body: bytes) -> str:
    """Return code and text of an error's body, or ""."""
    try:
        found = [each for each in _objects(msgspec.json.decode(body)) if "code" in each]
    except (msgspec.DecodeError, RecursionError):
        return ""
    if not found:
        return ""
    return f", code {clean(found[0]['code'])} {clean(found[0].get('msg', ''))}".rstrip()
