"""The comparison of transcripts in the documentation with what commands print."""

from __future__ import annotations

import pytest
from test_docs import PAGES
from transcripts import agree, renewed, steps

PAGE = """Say:

```text
$ gyrocal check bag
...
This bag can be used.
$ gyrocal replay bag
scale  0.9851 ± 0.0003
```
"""


def test_the_steps_of_a_page() -> None:
    check, replay = steps(PAGE)
    assert check.command == 'gyrocal check bag' and check.output == ('...', 'This bag can be used.')
    assert replay.output == ('scale  0.9851 ± 0.0003',)


def test_the_pages_have_transcripts() -> None:
    assert sum(len(list(steps(page.read_text(encoding='utf-8')))) for page in PAGES) > 20


@pytest.mark.parametrize(
    ('expected', 'printed', 'are_same'),
    [
        (['...', 'end'], ['a', 'b', 'end'], True),
        (['...', 'end'], ['a', 'b'], False),
        (['a', '...'], ['a'], True),
        (['drift 0.89 deg'], ['drift 0.90 deg'], True),
        (['drift 0.89 deg'], ['drift 0.99 deg'], False),
        (['k = -0.000805 1/K'], ['k = 0.000805 1/K'], False),
        (['Missing: gyro_lag.'], ['Missing: scale_cubic.'], False),
        (['a'], ['a', 'b'], False),
    ],
)
def test_lines_agree(expected: list[str], printed: list[str], are_same: bool) -> None:
    assert agree(expected, printed) == are_same


def test_a_transcript_is_renewed() -> None:
    expected = ['scale  0.9851 ± 0.0003', '...', 'drift 0.89 deg, held out', '...']
    printed = ['scale  0.9852 ± 0.0002', 'bias 1', 'drift  0.5 deg, held out', 'end']
    assert renewed(expected, printed) == [
        'scale  0.9852 ± 0.0002',
        '...',
        'drift  0.5 deg, held out',
        '...',
    ]


def test_the_beginning_and_the_end_are_renewed_whatever_they_say() -> None:
    printed = ['[red] The model does not fit.', 'scale 1.0', 'bias 0.1', 'Report: report.html']
    assert renewed(['scale 1.0', '...', 'The end'], printed) == [printed[0], '...', printed[-1]]
    assert renewed(['scale 1.0'], printed) == printed, 'nothing was omitted'
