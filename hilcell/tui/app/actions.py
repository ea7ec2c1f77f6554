"""What a technician does with the run that is shown; what may move something asks first."""

from __future__ import annotations

from collections.abc import Coroutine
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from hilcell.errors import HilcellError
from hilcell.tui.engine import process
from hilcell.tui.engine.background import run_in_thread
from hilcell.tui.text.refusals import no_answer_reason, pause_command

if TYPE_CHECKING:
    from hilcell.run.protocol import Command
    from hilcell.tui.engine.session import Session


class Host(Protocol):
    """The application as its acts see it."""

    key_is_deliberate: bool  # whether the key under way came by itself, not in a burst

    @property
    def session(self) -> Session | None:
        """Return the attachment to the run that is shown."""

    def ask(self, title: str, text: str, yes: str, act: Any) -> None:
        """Ask before an act; only a yes does it."""

    def show_notice(self, text: str, *, for_now: bool = False) -> None:
        """Say something on the line above the keys."""

    def start_task(self, work: Coroutine[Any, Any, None]) -> None:
        """Do something that may take a while; what goes wrong is said."""

    def attach(self, folder: Path, process: Any = None) -> None:
        """Show a run in place of the one shown."""


class RunActions:
    """Turns what is pressed into commands to the engine, or into an engine's start."""

    def __init__(self, host: Host) -> None:
        self._host = host

    def do_pause(self) -> None:
        """Pause, go on, answer what is asked, or resume: whichever the state allows."""
        session = self._host.session
        if session is None:
            return
        command = pause_command(session.view)
        if session.view.prompt is not None:
            self.answer()
        elif command == "pause":
            self._command("pause")
        elif command == "resume":
            from hilcell.tui.text.run import resume_text

            self._host.ask("Resume this run?", resume_text(session.view), "resume", self.resume)
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
        if session is None or session.view.prompt is None:
            return
        if refused := no_answer_reason(session.view):
            self._host.show_notice(refused)
        elif session.view.prompt.check and not session.view.prompt.ready:
            self._host.show_notice(
                "Enter works when the tracker sees the reflector in its place", for_now=True
            )
        elif not self._host.key_is_deliberate:
            self._host.show_notice(
                "Enter in one burst with other keys is no answer: press it by itself"
            )
        else:
            self._host.start_task(self._look_once_more(session))

    def retake(self, key: str) -> None:
        """Re-measure a point: in the live run, or by opening a finished one again."""
        from hilcell.run.retake import retake_refusal

        session = self._host.session
        if session is None:
            return
        refused = retake_refusal(session.view.log, key) if key else "no point is chosen"
        if refused:
            self._host.show_notice(refused)
        elif session.view.live:
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
        attended = [] if not session.view.log.inputs.unattended else ["--unattended"]
        order = ["resume", folder.name, "--runs", str(folder.parent), *attended, *words]
        self.start(folder, order)

    def start(self, folder: Path, words: list[str]) -> None:
        """Start an engine and show its run; what it says where no journal tells is said here."""
        started = process.start_engine(folder.parent, folder.name, words)
        self._host.attach(folder, started.process)
        self._host.start_task(_watch(started))

    async def _look_once_more(self, session: Session) -> None:
        self._host.show_notice("the tracker looks once more ...")
        await run_in_thread(session.ask, "answer")
        self._host.show_notice("")

    def _command(self, command: Command, *, key: str = "") -> None:
        """Send a command to the engine, off the thread that takes keys."""
        session = self._host.session
        if session is not None:
            self._host.start_task(run_in_thread(session.ask, command, key=key))


async def _watch(started: process.StartedEngine) -> None:
    if told := await run_in_thread(started.wait_for_end):
        raise HilcellError(told)
