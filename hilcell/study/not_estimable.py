"""Why effects of a study are not estimable, and what would help, in lines for people."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping

from hilcell.study.additive import Additive
from hilcell.study.case import CANNOT_BE, FAILED
from hilcell.study.design import Point
from hilcell.study.factor import Factor
from hilcell.study.study_file import Study

Steps = Collection[tuple[str, str]]


def not_estimable(
    study: Study, model: Additive, done: Collection[Point], tried: Collection[Point], steps: Steps,
    counts: Mapping[str, int],
) -> list[str]:  # fmt: skip
    """Return why steps other than ``steps`` (factor, level) have no figures, and what would help.

    ``done`` are the points of the model; ``tried`` those of all rows, in ``counts`` by state.
    """
    lines = [line for n in range(len(study.factor)) for line in _unseen(n, model, done)]
    lines += _mixed(study, model, len(done))
    helped = [_help(study, counts)] if lines else []
    for n, factor in enumerate(study.factor):
        lines += _extrapolated(n, factor, done, tried)
        lines += _apart(n, factor, model, steps)
    return [*lines, *helped]


def _unseen(n: int, model: Additive, done: Collection[Point]) -> Iterator[str]:
    """Yield that a factor did not vary, or which of its levels have no result."""
    choices = [each.choices[n] for each in done]
    factor, seen = choices[0].factor, {each.share for each in choices}
    if len(seen) == 1:
        yield (
            f"{factor.title}: every design with a result has {choices[0].word}, so its effect is "
            "unknown."
        )
    elif not factor.is_range:
        never = [word for level, word in enumerate(factor.names) if level not in seen]
        start = model.start(n)
        since = f"; changes are counted from {factor.names[start]}" if start else ""
        if never:
            yield f"{factor.title}: no design with {_listed(never, 'or')} has a result{since}."


def _mixed(study: Study, model: Additive, designs: int) -> Iterator[str]:
    for group in model.inseparable():
        names = _listed([study.factor[n].title for n in group], "and")
        few = f" (designs: {designs}, unknowns: {model.unknowns})" * (designs < model.unknowns)
        yield (
            f"{names} change together in the designs with results{few}: effects without a figure "
            "cannot be separated."
        )


def _extrapolated(
    n: int, factor: Factor, done: Collection[Point], tried: Collection[Point]
) -> Iterator[str]:
    """Yield where the results of a range end, if further cases had none."""
    if factor.is_range:
        found = sorted((each.choices[n] for each in done), key=lambda each: each.share)
        wanted = [each.choices[n].share for each in tried]
        low, high = found[0], found[-1]
        if low.share < high.share and (min(wanted) < low.share or high.share < max(wanted)):
            yield (
                f"{factor.title}: results lie between {low.word} and {high.word} only; beyond "
                "them its effect is extrapolated."
            )


def _apart(n: int, factor: Factor, model: Additive, steps: Steps) -> Iterator[str]:
    """Yield the steps that only machines together would show."""
    start = model.start(n)
    words = [
        word
        for level, word in enumerate(factor.names)
        if level != start
        and (factor.name, word) not in steps
        and model.estimable(model.change(n, level, start))
    ]
    if words:
        yield (
            f"{factor.title}: no machine by itself has the results that show the change to "
            f"{_listed(words, 'or')}."
        )


def _help(study: Study, counts: Mapping[str, int]) -> str:
    if (waiting := study.most_cases - sum(counts.values())) > 0:
        return f"Cases that are not measured yet: {waiting}."
    if study.samples is not None:
        unknowns = 1 + sum(1 if f.is_range else len(f.ends) - 1 for f in study.factor)
        wanted = max(2 * study.samples, 1 << (2 * unknowns - 1).bit_length())
        return f"More samples would help, {wanted} for example."
    if counts.get(CANNOT_BE, 0) or counts.get(FAILED, 0):
        return "Levels that can all be combined would help; see the cases without a result."
    return "More levels or combinations would help."


def _listed(words: Collection[str], last: str) -> str:
    *before, end = words
    return f"{', '.join(before)} {last} {end}" if before else end
