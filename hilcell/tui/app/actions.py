"""The technician's actions on the run that is shown; those that may move something ask first."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Unpack

from hilcell.errors import HilcellError
from hilcell.tui.engine import process
from hilcell.tui.engine.background import run_in_thread
from hilcell.tui.screens.base import Application
from hilcell.tui.text.refusals import no_answer_reason, pause_command

if TYPE_CHECKING:
    from hilcell.run.protocol import Command, Subject
    from hilcell.tui.engine.session import Session


class RunActions:
    """Turns keys into commands to the engine, or starts an engine."""

    def __init__(self, application: Application) -> None:
        self._application = application

    def do_pause(self) -> None:
        """Pause, go on, answer the prompt, or resume, as the state allows."""
        session = self._application.session
        if session is None:
            return
        command = pause_command(session.view)
        if session.view.prompt is not None:
            self.answer()
        elif command == "pause":
            self._command("pause")
        elif command == "resume":
            from hilcell.tui.text.run import resume_text

            self._application.ask(
                "Resume this run?", resume_text(session.view), "resume", self.resume
            )
        else:
            self._application.ask(
                "Go on?",
                "The robot and the rail may move at once."
                if session.view.has_rail
                else "The robot may move at once.",
                "go on",
                lambda: self._command("proceed"),
            )

    def do_abort(self) -> None:
        """End the run after the point in flight."""
        self._application.ask(
            "Abort this run?",
            "The point in flight is finished, then the run ends. It can be resumed later.",
            "abort",
            lambda: self._command("abort"),
        )

    def answer(self) -> None:
        """Answer the prompt, where the engine answers and the tracker sees the reflector."""
        session = self._application.session
        if session is None or session.view.prompt is None:
            return
        if refused := no_answer_reason(session.view):
            self._application.show_notice(refused)
        elif session.view.prompt.check and not session.view.prompt.ready:
            from hilcell.tui.text.prompt import lost_devices

            lost = lost_devices(session.view)
            waits = "the tracker sees the reflector in its place"
            if lost:
                waits = f"no device is lost; now: {lost}"
            self._application.show_notice(f"Enter works when {waits}", for_now=True)
        elif not self._application.key_is_deliberate:
            self._application.show_notice(
                "Enter in one burst with other keys is no answer: press it by itself"
            )
        else:
            self._application.start_task(self._answer_prompt(session))

    def retake(self, key: str) -> None:
        """Re-measure a point: in the live run, or by opening a finished one again."""
        from hilcell.journal.words import in_words, key_words
        from hilcell.run.remeasure import retake_refusal

        session = self._application.session
        if session is None:
            return
        log = session.view.log
        refused = retake_refusal(log, key) if key else "no point is chosen"
        point = key_words(key, log) if key in log.points else key
        if refused:
            self._application.show_notice(in_words(refused, log))
        elif session.view.live:
            self._application.ask(
                "Re-measure this point?",
                f"{point}: before the robot's next point; it moves there.",
                "re-measure",
                lambda: self._command("retake", key=key),
            )
        else:
            self._application.ask(
                "Open this run again and re-measure the point?",
                f"{point}: the devices are connected, the control points proved, the robot moves.",
                "re-measure",
                lambda: self.resume("--retake", key),
            )

    def resume(self, *options: str) -> None:
        """Start an engine that goes on with the run that is shown."""
        session = self._application.session
        if session is None:
            return
        folder = session.folder
        attended = [] if not session.view.log.inputs.unattended else ["--unattended"]
        command = ["resume", folder.name, "--runs", str(folder.parent), *attended, *options]
        self.start(folder, command)

    def start(self, folder: Path, arguments: list[str]) -> None:
        """Start an engine and show its run; report an end that the journal does not hold."""
        started = process.start_engine(folder.parent, folder.name, arguments)
        self._application.attach(folder, started.process)
        self._application.start_task(_watch(started))

    async def _answer_prompt(self, session: Session) -> None:
        self._application.show_notice("the tracker looks once more ...")
        await run_in_thread(session.ask, "answer")
        self._application.show_notice("")

    def _command(self, command: Command, **subject: Unpack[Subject]) -> None:
        """Send a command to the engine from another thread: keys do not wait."""
        session = self._application.session
        if session is not None:
            self._application.start_task(run_in_thread(session.ask, command, **subject))


async def _watch(started: process.StartedEngine) -> None:
    if reason := await run_in_thread(started.wait_for_end):
        raise HilcellError(reason)
