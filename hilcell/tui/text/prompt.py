"""The operator's prompt as text: the task, the nest, the expected reading and the actual one."""

from __future__ import annotations

from textual.content import Content

from hilcell.cell.file import Layout
from hilcell.run.protocol import PromptStatus
from hilcell.tui.engine.run_view import RunView
from hilcell.tui.terminal.capabilities import Glyphs
from hilcell.tui.text.run import short_age

MAP_WIDTH, MAP_HEIGHT = 34, 5
MOST_LINES = 3  # of a prompt's text


def prompt_lines(prompt: PromptStatus, view: RunView, glyphs: Glyphs, width: int) -> Content:
    """Return element 9: one prompt, with the nest drawn where there is one."""
    title = Content.styled(prompt.title, "bold $ask").truncate(width, ellipsis=True)
    text = Content(prompt.text.replace("\n", " ")).truncate(MOST_LINES * width, ellipsis=True)
    parts = [title, text]  # short, so that what the tracker sees stays in tracker_text
    if prompt.expected_mm is not None:
        x, y, z = prompt.expected_mm
        parts.append(
            Content(f"expected reading: x {x:.1f}  y {y:.1f}  z {z:.1f} mm, tracker's frame")
        )
    parts.append(tracker_text(prompt, view))
    drawing = nest_map(view.log.cell.layout, prompt.place, glyphs)
    return Content("\n").join(parts + drawing)


def tracker_text(prompt: PromptStatus, view: RunView) -> Content:
    """Return what the tracker sees there, and whether Enter works."""
    if not prompt.check:
        return Content.styled("Enter when it is done", "bold $passed")
    if view.stale or prompt.age_s is None:
        return Content.styled("the tracker has not looked yet; Enter does not work", "$label")
    age = short_age(prompt.age_s + view.status_age_s)
    if prompt.expected_mm is None:
        return _strip_text(prompt, age)
    if prompt.seen_mm is None:
        return Content.styled(f"tracker: sees nothing there ({age} ago); Enter waits", "$ask")
    limit = "" if prompt.limit_mm is None else f", limit {prompt.limit_mm:.1f}"
    seen = f"tracker: reflector {prompt.seen_mm:.2f} mm from there{limit} ({age} ago)"
    if not prompt.ready:
        return Content.styled(f"{seen}; Enter waits", "$ask")
    return Content.styled(f"{seen}; press Enter", "bold $passed")


def _strip_text(prompt: PromptStatus, age: str) -> Content:
    if not prompt.ready:
        return Content.styled(f"{prompt.place} does not read well ({age} ago); Enter waits", "$ask")
    return Content.styled(f"{prompt.place} reads well ({age} ago); press Enter", "bold $passed")


def nest_map(layout: Layout, place: str, glyphs: Glyphs) -> list[Content]:
    """Return the floor or the slide from above, the wanted nest marked; x right, y up."""
    floor = {nest.name: nest.xyz_mm for nest in layout.standing}
    slide = {nest.name: nest.xyz_mm for nest in layout.slide}
    where = floor if place in floor else slide
    if place not in where:
        return []
    cells = [[" "] * MAP_WIDTH for _ in range(MAP_HEIGHT)]
    xs = [float(xyz[0]) for xyz in where.values()]
    ys = [float(xyz[1]) for xyz in where.values()]
    for name, xyz in sorted(where.items(), key=lambda item: item[0] == place):
        # Nests overlap in this view: only the wanted one is named.
        column = _scale(float(xyz[0]), xs, MAP_WIDTH - 6)
        row = MAP_HEIGHT - 1 - _scale(float(xyz[1]), ys, MAP_HEIGHT - 1)
        label = f">{name[:3]}<" if name == place else " o  "
        cells[row][column : column + len(label)] = label
    title = "floor" if where is floor else "slide"
    lines = [Content.styled(f"the {title} from above: x right, y up", "$label")]
    return lines + [_marked("".join(row), f">{place[:3]}<") for row in cells]


def _scale(value: float, values: list[float], most: int) -> int:
    low, high = min(values), max(values)
    return round((value - low) / (high - low) * most) if high > low else most // 2


def _marked(line: str, label: str) -> Content:
    before, found, after = line.partition(label)
    return Content.assemble(before, (found, "bold $on-ask on $ask-fill"), after)
