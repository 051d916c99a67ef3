"""The page about a diagnosis: what the model lacks, for someone who would rather look than read."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from html import escape

from gyrocal_ros import __version__
from gyrocal_ros.diagnose.advice import grouped
from gyrocal_ros.diagnose.diagnosis import Diagnosis, MissingEffect
from gyrocal_ros.diagnose.drift import REFERENCES, BlindDrift
from gyrocal_ros.diagnose.regimes import Failure
from gyrocal_ros.diagnose.search import ExaminedModel, Search
from gyrocal_ros.effects import find_effect
from gyrocal_ros.effects.model_file import model_to_yaml
from gyrocal_ros.report import diagnosis_series as series
from gyrocal_ros.report.conclusions import of_diagnosis
from gyrocal_ros.report.figures import diagnosis as figures
from gyrocal_ros.report.figures.models import Mark, drift_by_span
from gyrocal_ros.report.html import (
    Section,
    details,
    document,
    gallery,
    meter_table,
    table,
    verdict_box,
    warnings,
)
from gyrocal_ros.report.model_sections import drift_section, heading_section
from gyrocal_ros.report.page import events
from gyrocal_ros.report.tables import estimate_rows

STRETCHES = 5
"""No more stretches of time are marked than these, the worst ones."""
FAILURES = 12
CAPTIONS = {
    'evidence': """Left, how much better the recording would be foreseen with each effect in the model; right,
        how far that is beyond chance, whatever the noise settings are. Long to the left and short to the
        right: it fits only a part of the recording. {diamonds}""",
    'contribution': """By the values that were found, with three standard deviations of doubt.""",
    'drift_by_span': """Each mark is a span of {span_s:.0f} s in the later part of the recording, with what
        was known at its beginning, compared with {reference}; the lines are the rms.""",
}
LEFT_OVER = (
    "What the gyro's bias and scale would have to be, as free functions of all that was recorded, the most "
    'telling first; told less the mean (by the rate: less a straight line, which is the scale factor), with '
    'three standard deviations. Where nothing is missing, the bars reach zero. Beware: a signal that changes '
    'slowly fits anything that does.'
)
DIAMONDS_SAY = (
    'Several effects may look significant as long as another is missing, which they resemble. The diamonds '
    'say what is left of that once it is in the model: to the left of the dashed line, nothing.'
)


def diagnosis_page(searched: Search, diagnosis: Diagnosis, findings: Sequence[tuple[str, str]] = ()) -> str:
    """The whole page as HTML text.

    Args:
        searched: the search that was made.
        diagnosis: what follows from it.
        findings: severity and text of what is odd about the recording.
    """
    run = searched.first.run
    return document(
        f'Diagnosis of {run.source}',
        f'{run.span.duration_s:.0f} s recorded, model {run.model.name}, gyrocal {__version__}',
        [
            verdict_box(of_diagnosis(diagnosis)),
            warnings([*findings, *events(run)]),
            *(_card(finding) for finding in diagnosis.missing),
            gallery(_sections(searched, diagnosis)),
            gallery(_left_over(searched), 'What is left over', LEFT_OVER),
            _failures(diagnosis.fails_where),
            _not_judged(diagnosis),
            details('Sensor model with what was found (model.yaml)', model_to_yaml(searched.last.model)),
        ],
    )


def diagnosis_sections(searched: Search, diagnosis: Diagnosis) -> Iterator[Section]:
    """The figures of the page."""
    yield from _sections(searched, diagnosis)
    yield from _left_over(searched)


def _card(finding: MissingEffect) -> str:
    about = find_effect(finding.effect.name).about
    heads = ('coefficient', 'found', 'unit', 'which means')
    return (
        table(f'Missing: {finding.effect.name}', heads, estimate_rows(finding))
        + f'<p class="physics">{escape(about.physics)}</p>'
        + f'<p class="physics"><b>Equation</b> <code>{escape(about.equation)}</code></p>'
    )


def _sections(searched: Search, diagnosis: Diagnosis) -> Iterator[Section]:
    first = searched.first
    seen = {name: stage.seen for name, stage in _first_and_last(searched).items()}
    stretches = [failure for failure in diagnosis.fails_where if failure.from_s is not None][:STRETCHES]
    odd = diagnosis.unexplained
    jump_s = None if odd is None else odd.at_s
    title = 'Heading by the gyro alone' if diagnosis.verdict == 'nothing_missing' else 'Where the model fails'
    yield heading_section(title, seen, first.run.history, stretches, jump_s)
    candidates = series.candidates(searched, diagnosis)
    has_diamonds = any(row.role == 'found' for row in candidates)
    yield _section('evidence', figures.scores(candidates), diamonds=DIAMONDS_SAY if has_diamonds else '')
    for number, finding in enumerate(diagnosis.missing, start=1):
        drawn = series.contribution(finding)
        if drawn is not None:
            drawn_figure = figures.contribution(finding.effect.name, drawn)
            yield Section(f'contribution_{number}', drawn_figure, CAPTIONS['contribution'], half=True)
    yield from _drift_sections(series.held_out_drifts(searched), diagnosis.drift_reference)


def _first_and_last(searched: Search) -> dict[str, ExaminedModel]:
    """The model as it was, where it ran at all, and that with all that was found."""
    (name, first), *more = series.stages(searched).items()
    return {name: first, 'with all that was found': searched.last} if more else {name: first}


def _left_over(searched: Search) -> Iterator[Section]:
    name, *_ = _first_and_last(searched)
    for number, asked in enumerate(series.bends(searched), start=1):
        figure = figures.bend(asked, (name, 'with all that was found'))
        yield Section(f'left_over_{number}', figure, '', half=True)


def _drift_sections(drifts: Mapping[str, BlindDrift], reference: str) -> Iterator[Section]:
    if not all(len(drift.error_rad) for drift in drifts.values()):
        return
    if len(drifts) > 1:
        marks = [Mark(name, 'held out', drift) for name, drift in drifts.items()]
        yield drift_section('Drift without the camera', marks, half=True)
    span_s = next(iter(drifts.values())).span_s
    facts: dict[str, float | str] = {'span_s': span_s, 'reference': REFERENCES[reference]}
    yield _section('drift_by_span', drift_by_span(drifts), half=True, **facts)


def _section(name: str, figure: object, half: bool = False, **facts: float | str) -> Section:
    return Section(name, figure, CAPTIONS[name].format(**facts), half)


def _failures(failures: Sequence[Failure]) -> str:
    if not failures:
        nowhere = 'Nowhere by more than chance and a slowly wandering bias explain.'
        return f'<h2>Where the model fails</h2><p>{nowhere}</p>'
    shown = [(failure.what, failure.sigma) for failure in failures[:FAILURES]]
    more = ''
    if len(failures) > FAILURES:
        rest = '\n'.join(f'{failure.sigma:5.1f} sigma  {failure.what}' for failure in failures[FAILURES:])
        more = details(f'{len(failures) - FAILURES} more', rest)
    note = """Worst first. Each place is judged by itself, so one cause shows in many places: the first
        says most."""
    heads = ('place, and what would have to be added', 'sigma')
    return meter_table('Where the model fails', heads, shown, ' '.join(note.split())) + more


def _not_judged(diagnosis: Diagnosis) -> str:
    if not diagnosis.not_judged:
        return '<h2>What cannot be judged</h2><p>Every effect of the library could be judged.</p>'
    rows = [(', '.join(names), why) for why, names in grouped(diagnosis.not_judged).items()]
    return table('What this recording cannot judge', ('effect', 'why'), rows)
