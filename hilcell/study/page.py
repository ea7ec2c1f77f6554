"""The answers of a study as one HTML page: no script, prints on A4."""

from __future__ import annotations

from hilcell import __version__
from hilcell.report.sheet import environment
from hilcell.study.analysis import Answers, Rows
from hilcell.study.outcome import RESULTS
from hilcell.study.plots import coverage_plot, effects_plot, front_plot
from hilcell.study.study_file import Study
from hilcell.study.tables import (
    best_sheet,
    count_words,
    effects_sheet,
    front_sheet,
    purchases_sheet,
    reasons_sheet,
)


def page(study: Study, found: Answers, rows: Rows, planned: int) -> str:
    """Return the page, the same from the same rows."""
    return (
        environment("hilcell.study")
        .get_template("study.html.j2")
        .render(
            study=study,
            version=__version__,
            counts=count_words(study, found, planned),
            meaning=RESULTS[study.accuracy][0],
            settings=[f"{key} = {value}" for key, value in study.settings.items()],
            best=best_sheet(study, found),
            front=front_sheet(study, found),
            purchases=purchases_sheet(study, found),
            effects=effects_sheet(study, found),
            reasons=reasons_sheet(rows),
            front_plot=front_plot(study, found),
            effects_plot=effects_plot(study, found),
            coverage_plot=coverage_plot(found),
        )
    )
