"""What stands beside the points on a wide terminal: the errors sorted, and the newest records."""

from __future__ import annotations

from textual.content import Content

from hilcell.tui.engine.scene import Scene
from hilcell.tui.text.plot import draw
from hilcell.tui.text.record import record_words
from hilcell.tui.text.series import sorted_plot

LEAST_PLOT = 8


def side_lines(scene: Scene, width: int, height: int) -> Content:
    """Return a plot over the newest records, in a space of this size."""
    plot_height = max(LEAST_PLOT, height // 2)
    plot = sorted_plot(scene.log)
    lines = [Content.styled(plot.title, "bold"), draw(plot, width, plot_height)]
    newest = scene.records[-max(height - plot_height - 2, 1) :]
    lines.append(Content.styled("newest records", "bold"))
    lines += [
        Content.assemble((f"{record.t[11:19]} ", "$dim"), record_words(record)).truncate(
            width, ellipsis=True
        )
        for record in newest
    ]
    return Content("\n").join(lines)
