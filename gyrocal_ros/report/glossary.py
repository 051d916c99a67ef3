"""Terms of pages and documents, each explained in one place; `docs/glossary.md` has the same text."""

from __future__ import annotations

import re
from collections.abc import Iterator
from html import escape

TERMS: dict[str, str] = {
    'bias': 'Constant part of the error of the rate, in deg/s: true rate = scale factor x rate + bias. '
    'It is different after each start and drifts slowly.',
    'blind drift': 'Error of the heading after 60 s by the gyro alone, as under a bed, where the camera'
    ' sees nothing. Each span begins with the heading and the calibration known at that time.',
    'coefficient': 'Number in the equation of an effect that the filter estimates, such as the change '
    'of the scale factor for each kelvin.',
    'converged': 'The scale factor is known to the required accuracy (0.05 % by default), and the '
    'recording agrees with the model.',
    'effect': 'Physical cause of an error, as an equation with one or more coefficients. A sensor model'
    ' is a list of effects.',
    'fitted': 'Measured on data that were also used for the estimate. Compare with held out: a fitted '
    'error that is much smaller means that the model follows the noise.',
    'ground truth': 'True position and heading, known for simulated robots and for recordings with an '
    'external measurement. Results are compared with it; no estimate uses it.',
    'held out': 'Measured on data that were not used for the estimate with which they are compared. '
    'Only a held-out error shows how well a model predicts.',
    'indistinguishable effects': 'Effects that change the measurements of this recording in the same '
    'way, because the robot moved in a way that excites both alike. A different drive distinguishes '
    'them.',
    'innovation': 'Measurement minus its prediction by the filter from all measurements before it.',
    'log-likelihood': 'Logarithm of the probability of the recording under a model. A gain of 3 '
    'corresponds to odds of 20 to 1 for the better model.',
    'NIS': 'Normalised innovation squared: the square of an innovation, divided by its variance '
    'according to the filter. Per degree of freedom its mean is 1 for a consistent filter; larger means'
    ' that the errors are larger than the filter expects.',
    'NEES': 'Normalised estimation error squared: the square of the true error, divided by its variance '
    'according to the filter. Its mean is 1 for each estimated number; it needs ground truth.',
    'not judged': 'Effects that this recording cannot show, because the robot did not move as it takes '
    'or a signal was not recorded. They may be present or absent.',
    'predictive gain': 'Increase of the log-likelihood where each measurement is predicted from those '
    'before it only. A useless coefficient does not raise it, unlike the fit. Of an image, the features '
    'count that both models use.',
    'residual': 'Difference between measurement and model after the fit.',
    'revision': 'Sensor model after one more effect was tried, with its errors.',
    'scale factor': 'True rate divided by the rate that the gyro shows. 0.98 means that the gyro shows '
    '2 % too much. In deg/s/V it is the constant of the data sheet times that number.',
    'sensor model': 'The effects whose coefficients the filter estimates; the file model.yaml.',
    'sigma': 'Distance from zero, or from chance, in standard deviations. Beyond 4 sigma chance is '
    'ruled out in practice, even if many effects are tried.',
    'standard deviation': 'Uncertainty of an estimate, the number after ±. The true value is within one'
    ' standard deviation in 68 % of cases, and within three in 99.7 %.',
    'unexplained structure': 'Errors that are not chance and that no effect of the library explains, '
    'with the time or the signal that they follow.',
}
"""Terms and their explanations, in plain text."""

SPELLINGS = {
    'blind drift': 'blind drift|drift in 60 s',
    'held out': 'held[ -]out',
    'indistinguishable effects': 'indistinguishable(?: effects| from)?|cannot be distinguished',
    'NIS': 'NIS(?:/dof)?',
    'predictive gain': 'predictive gain|predictive log-likelihood',
    'unexplained structure': 'unexplained(?: structure)?',
}
"""Regular expressions of terms that are written in several ways."""

LONGEST_FIRST = sorted(TERMS, key=len, reverse=True)
ANY_TERM = re.compile(
    '|'.join(rf'\b((?i:{SPELLINGS.get(term, re.escape(term) + "s?")}))\b' for term in LONGEST_FIRST)
)
"""Matches a term; the number of the group is its place in `LONGEST_FIRST`."""

SKIPPED = re.compile(r'<(script|style|code|pre|h1|h2|summary|a)\b.*?</\1>|<[^>]*>', re.DOTALL | re.IGNORECASE)
"""Parts of a page whose words are not linked."""


def as_markdown() -> str:
    """Return the glossary as a page of the documentation."""
    parts = ['# Glossary', '', 'The terms of reports, pages and the command line.', '']
    for term in sorted(TERMS, key=str.lower):
        parts += [f'## {term[0].upper()}{term[1:]}', '', TERMS[term], '']
    return '\n'.join(parts)


def with_terms(body: str) -> str:
    """Link the first use of each term in the body of a page to its explanation, which is added at the end.

    Args:
        body: HTML.
    """
    used: list[str] = []
    linked: list[str] = []
    last = 0
    for skipped in SKIPPED.finditer(body):
        linked += [_linked(body[last : skipped.start()], used), skipped.group()]
        last = skipped.end()
    linked.append(_linked(body[last:], used))
    return ''.join(linked) + ''.join(_explanations(used))


def anchor(term: str) -> str:
    """Return the name of the place where a term is explained."""
    return 'term-' + term.lower().replace(' ', '-')


def _linked(text: str, used: list[str]) -> str:
    """Link each term that is not in `used` yet, and add it there."""
    if not text.strip():
        return text

    def link(match: re.Match[str]) -> str:
        term = LONGEST_FIRST[(match.lastindex or 0) - 1]
        if term in used:
            return match.group()
        used.append(term)
        return f'<a class="term" href="#{anchor(term)}">{match.group()}</a>'

    return ANY_TERM.sub(link, text)


def _explanations(terms: list[str]) -> Iterator[str]:
    if terms:
        yield '<h2>Terms</h2><dl>'
        for term in sorted(terms, key=str.lower):
            yield f'<dt id="{anchor(term)}">{escape(term)}</dt><dd>{escape(TERMS[term])}</dd>'
        yield '</dl>'
