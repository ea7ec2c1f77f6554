"""Pages of text over a run: alarms, interlocks, help, one point."""

from __future__ import annotations

from textual.app import ComposeResult
from textual.containers import VerticalScroll
from textual.content import Content

from hilcell.tui.engine.scene import DeviceStatus, Scene
from hilcell.tui.screens.base import Page
from hilcell.tui.terminal.glyphs import Glyphs
from hilcell.tui.text import run as words
from hilcell.tui.text.alarms import alarm_page
from hilcell.tui.text.help import help_lines
from hilcell.tui.text.point import point_page
from hilcell.tui.widgets.panel import Panel


class TextPage(Page):
    """A page of text that scrolls."""

    fixed = (*Page.fixed, ("up down", "scroll"))

    def body(self) -> ComposeResult:
        """Build one text that scrolls."""
        with VerticalScroll(classes="scroll", id="body", can_focus=True):
            yield Panel("text")

    def show(self, scene: Scene | None) -> None:
        """Show the text."""
        super().show(scene)
        self.panel("text").show(self.text(scene))

    def text(self, scene: Scene | None) -> Content:
        """Return what the page says."""
        raise NotImplementedError


class AlarmPage(TextPage):
    """Every alarm: what it means, where, what to do."""

    title_text = "Alarms"
    footer = ("stop", "acknowledge", "pause", "quit")

    def text(self, scene: Scene | None) -> Content:
        """Return the alarms, newest first."""
        if scene is None:
            return Content("")
        return alarm_page(scene.alarms, self.cell.latch, self.cell.glyphs)


class InterlockPage(TextPage):
    """What may move now, why not, and what was last read."""

    title_text = "Interlocks: what must be true before anything moves"
    footer = ("stop", "pause", "quit")

    def text(self, scene: Scene | None) -> Content:
        """Return conditions and readings."""
        return interlock_page(scene, self.cell.glyphs) if scene is not None else Content("")


class HelpPage(TextPage):
    """What the keys do, what the lines say."""

    title_text = "Help"
    footer = ("stop", "quit")

    def text(self, scene: Scene | None) -> Content:
        """Return the help."""
        return help_lines(self.cell.keymap, self.cell.glyphs)


class DetailPage(TextPage):
    """One point, with everything that is known of it."""

    title_text = "One point"
    footer = ("stop", "pause", "alarms", "retake", "quit")

    def __init__(self, key: str) -> None:
        super().__init__()
        self._key = key

    def text(self, scene: Scene | None) -> Content:
        """Return the point."""
        return point_page(scene, self._key) if scene is not None else Content("")

    def do_retake(self) -> None:
        """Re-measure this point."""
        self.cell.acts.retake(self._key)


def interlock_page(scene: Scene, glyphs: Glyphs) -> Content:
    """Return element 15 whole: each condition, then each device's last reading."""
    status = scene.status
    if status is None or not scene.live:
        return Content("No engine is at work on this run: nothing can move from here.")
    lines = [
        Content.styled(f"{glyphs.lost} {each.name} blocked: {each.blocked}", "bold $warn")
        if each.blocked
        else Content.styled(f"{glyphs.fresh} {each.name}: free", "$good")
        for each in status.interlocks
    ]
    lines.append(Content(""))
    for name in words.LAMPS:
        device = status.devices.get(name, DeviceStatus())
        head = words.lamp(name, device, scene, glyphs)
        said = device.reason or device.text
        lines.append(head.append(f"   {said}" if said else ""))
    lines += [
        Content(""),
        Content.styled(
            "These interlocks protect the measurement. They are no safety function: guards, "
            "enabling switch and E-stop work without hilcell.",
            "$dim",
        ),
    ]
    return Content("\n").join(lines)
