"""What a technician does with the run that is shown; what may move something asks first."""

from __future__ import annotations

from collections.abc import Coroutine
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from hilcell.errors import HilcellError
from hilcell.tui.engine import process as engine
from hilcell.tui.engine.background import aside
from hilcell.tui.text.refusals import pause_command, unheard

if TYPE_CHECKING:
    from hilcell.run.protocol import Command
    from hilcell.tui.engine.session import Session


class Host(Protocol):
    """The application as its acts see it."""

    unhurried: bool  # whether the key under way came by itself, not in a burst

    @property
    def session(self) -> Session | None:
        """Return the attachment to the run that is shown."""

    def ask(self, title: str, text: str, yes: str, act: Any) -> None:
        """Ask before an act; only a yes does it."""

    def say(self, text: str, *, for_now: bool = False) -> None:
        """Say something on the line above the keys."""

    def background(self, work: Coroutine[Any, Any, None]) -> None:
        """Do something that may take a while; what goes wrong is said."""

    def attach(self, folder: Path, process: Any = None) -> None:
        """Show a run in place of the one shown."""


class Acts:
    """Turns what is pressed into commands to the engine, or into an engine's start."""

    def __init__(self, host: Host) -> None:
        self._host = host

    def do_pause(self) -> None:
        """Pause, go on, answer what is asked, or resume: whichever the state allows."""
        session = self._host.session
        if session is None:
            return
        command = pause_command(session.scene)
        if session.scene.prompt is not None:
            self.answer()
        elif command == "pause":
            self._command("pause")
        elif command == "resume":
            from hilcell.tui.text.run import prospect

            self._host.ask("Resume this run?", prospect(session.scene), "resume", self.resume)
        else:
            self._host.ask(
                "Go on?",
                "The robot and the rail may move at once.",
                "go on",
                lambda: self._command("proceed"),
            )

    def do_abort(self) -> None:
        """End the run after the point in flight."""
        self._host.ask(
            "Abort this run?",
            "The point in flight is finished, then the run ends. It can be resumed later.",
            "abort",
            lambda: self._command("abort"),
        )

    def answer(self) -> None:
        """Answer the prompt, where the engine hears it and the tracker sees the reflector."""
        session = self._host.session
        if session is None or session.scene.prompt is None:
            return
        if refused := unheard(session.scene):
            self._host.say(refused)
        elif session.scene.prompt.check and not session.scene.prompt.ready:
            self._host.say(
                "Enter works when the tracker sees the reflector in its place", for_now=True
            )
        elif not self._host.unhurried:
            self._host.say("Enter in one burst with other keys is no answer: press it by itself")
        else:
            self._host.background(self._look_once_more(session))

    def retake(self, key: str) -> None:
        """Re-measure a point: in the live run, or by opening a finished one again."""
        from hilcell.run.retake import retake_refusal

        session = self._host.session
        if session is None:
            return
        refused = retake_refusal(session.scene.log, key) if key else "no point is chosen"
        if refused:
            self._host.say(refused)
        elif session.scene.live:
            self._host.ask(
                "Re-measure this point?",
                f"{key}: before the robot's next point; it moves there.",
                "re-measure",
                lambda: self._command("retake", key=key),
            )
        else:
            self._host.ask(
                "Open this run again and re-measure the point?",
                f"{key}: the devices are connected, the control points proved, the robot moves.",
                "re-measure",
                lambda: self.resume("--retake", key),
            )

    def resume(self, *words: str) -> None:
        """Start an engine that goes on with the run that is shown."""
        session = self._host.session
        if session is None:
            return
        folder = session.folder
        attended = [] if not session.scene.log.inputs.unattended else ["--unattended"]
        order = ["resume", folder.name, "--runs", str(folder.parent), *attended, *words]
        self.start(folder, order)

    def start(self, folder: Path, words: list[str]) -> None:
        """Start an engine and show its run; what it says where no journal tells is said here."""
        started = engine.start(folder.parent, folder.name, words)
        self._host.attach(folder, started.process)
        self._host.background(_watch(started))

    async def _look_once_more(self, session: Session) -> None:
        self._host.say("the tracker looks once more ...")
        await aside(session.ask, "answer")
        self._host.say("")

    def _command(self, command: Command, *, key: str = "") -> None:
        """Send a command to the engine, off the thread that takes keys."""
        session = self._host.session
        if session is not None:
            self._host.background(aside(session.ask, command, key=key))


async def _watch(started: engine.Started) -> None:
    if told := await aside(started.end):
        raise HilcellError(told)
