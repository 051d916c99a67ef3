"""Layout of the page. Its contents come from `panels` and `pictures`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from dash import dcc, html

from gyrocal_ros.report.plot import plot_config
from gyrocal_ros.studio.pictures import KINDS

POLL_MS, IDLE_POLL_MS = 400, 1000
"""Periods at which the page asks for changes: while something runs, and else."""
LEARN_HINT = 'Learn the law behind the error left over, as `gyrocal learn` does; nothing is added yet.'
VALIDATE_HINT = (
    'Run the first model and the present one over another recording, with the coefficients of this one.'
)
UPLOAD_HINT = 'An .mcap, .db3 or .bag, or drop a file or a folder of rosbag2 on the page.'
STEPS = (
    ('bag', '1', 'The recording'),
    ('model', '2', 'Model against measurement'),
    ('residual', '3', 'Where the model fails'),
    ('missing', '4', 'Missing effect'),
    ('history', '5', 'Error by revision'),
    ('lesson', '6', 'Lesson: find the hidden effect'),
)
"""Name, number and title of each part of the page, in its order."""


def layout(titles: Sequence[str], *, may_upload: bool = False) -> html.Div:
    """Return the page.

    Args:
        titles: titles of the recordings that may be opened.
        may_upload: True if the page receives recordings that are dropped on it.
    """
    return html.Div(
        [
            dcc.Interval(id='poll', interval=POLL_MS),
            *(dcc.Store(id=f'mark-{name}') for name in MARKS),
            dcc.Store(id='shown'),
            dcc.Store(id='acted'),
            dcc.Store(id='chosen'),
            dcc.Store(id='theme', storage_type='local'),
            _header(titles, may_upload),
            html.Main(
                [_bag(), _model(), _residual(), _missing(), _history(titles), _lesson()],
                id='main',
            ),
        ]
    )


MARKS = ('session', 'bag', 'model', 'missing', 'forecast', 'validation', 'lesson')
"""Parts of the state. The page stores a mark of each, which changes with that part."""


def _header(titles: Sequence[str], may_upload: bool) -> html.Header:
    jumps = [html.A(f'{number} {title.partition(":")[0]}', href=f'#{name}') for name, number, title in STEPS]
    return html.Header(
        [
            html.Div(
                [
                    html.H1(['gyrocal studio ', html.Span(id='title')]),
                    dcc.Dropdown(
                        id='recording',
                        options=_numbered(titles),
                        placeholder='open another',
                        clearable=False,
                        style={'display': 'block' if len(titles) > 1 else 'none'},
                    ),
                    *([_upload()] if may_upload else []),
                    html.Nav(jumps, **{'aria-label': 'Parts of the page'}),
                    html.Button('Light / dark', id='theme-button', className='quiet'),
                ],
                className='top',
            ),
            html.Div(
                [
                    html.Div(id='message', role='status', **{'aria-live': 'polite'}),
                    html.Progress(id='progress', max='100', value='0'),
                    html.Span(id='doing'),
                    html.Button('Cancel', id='cancel'),
                    html.Button('Resume', id='resume'),
                ],
                className='status',
            ),
        ]
    )


def _upload() -> html.Span:
    """Return the button for a recording of the user's, which the script of the page serves."""
    button = html.Button('Open a file', id='upload', className='quiet', title=UPLOAD_HINT)
    return html.Span([button, html.Span(id='upload-state', role='status')])


def _bag() -> html.Section:
    return _part('bag', [html.Div(id='bag-words')])


def _model() -> html.Section:
    return _part(
        'model',
        [
            _radio('kind', KINDS, 'heading', 'Quantity to show'),
            _graph('model-figure', 'tall'),
        ],
    )


def _residual() -> html.Section:
    return _part(
        'residual',
        [
            html.Div(
                [
                    html.Label('Error left over, as a function of', htmlFor='signal', id='signal-label'),
                    dcc.Dropdown(id='signal', clearable=False),
                    html.Button('Learn this', id='learn', disabled=True, title=LEARN_HINT),
                ],
                className='row',
            ),
            _graph('residual-figure', 'low'),
            html.P(
                'With three standard deviations, less the mean; against the rate, less a straight line. '
                'A slow signal fits everything that changes slowly.',
                className='note',
            ),
            html.Div(id='failures'),
        ],
    )


def _missing() -> html.Section:
    return _part(
        'missing',
        [
            html.P(id='verdict', className='verdict-line'),
            html.Div(
                [
                    html.Div(id='candidates', role='group', **{'aria-label': 'Effects that may be added'}),
                    html.Div(
                        [
                            html.Button('Add to the model', id='add', className='main', disabled=True),
                            html.Div(id='card'),
                        ]
                    ),
                ],
                className='halves',
            ),
            html.Details([html.Summary('All scores'), _graph('evidence-figure', 'tall')], id='evidence'),
        ],
    )


def _history(titles: Sequence[str]) -> html.Section:
    return _part(
        'history',
        [
            _graph('history-figure', 'low'),
            html.Div(id='revisions'),
            html.Div(
                [
                    html.Button('Undo', id='undo'),
                    html.Button('Write model and calibration', id='write'),
                    html.Button('Export the report', id='export'),
                    html.Span(id='downloads', className='row'),
                ],
                className='row',
            ),
            html.Details(
                [
                    html.Summary('Test on another recording'),
                    html.Div(
                        [
                            html.Label('test recording', htmlFor='other'),
                            dcc.Dropdown(id='other', options=_numbered(titles), clearable=False),
                            html.Button('Test', id='validate', title=VALIDATE_HINT),
                        ],
                        className='row',
                    ),
                    html.Div(id='validation'),
                ],
                id='test',
                hidden=len(titles) < 2,
            ),
            html.Details(
                [
                    html.Summary('Compare two revisions'),
                    html.Div(
                        [
                            html.Label('first', htmlFor='left'),
                            dcc.Dropdown(id='left', clearable=False),
                            html.Label('second', htmlFor='right'),
                            dcc.Dropdown(id='right', clearable=False),
                            html.Button('Use the second revision', id='go-to'),
                        ],
                        className='row',
                    ),
                    _radio('compare-kind', KINDS, 'heading', 'Quantity to compare'),
                    _graph('compare-figure', 'tall'),
                ],
                id='compare',
            ),
        ],
    )


def _lesson() -> html.Section:
    return _part(
        'lesson',
        [
            html.P(
                'A simulated robot has one or two hidden effects, none, or one that is not in the library. '
                'Explore the recording, add the effects that you find, enter a guess, and see the answer.'
            ),
            html.Div(
                [
                    html.Button('New exercise', id='riddle'),
                    html.Label('My guess', htmlFor='guess'),
                    dcc.Dropdown(id='guess', placeholder='hidden effect'),
                    html.Button('Reveal the answer', id='reveal'),
                ],
                className='row',
            ),
            html.Div(id='truth-words', **{'aria-live': 'polite'}),
        ],
    )


def _part(name: str, content: list[Any]) -> html.Section:
    _, number, title = next(step for step in STEPS if step[0] == name)
    heading = html.H2([html.Span(number, className='number'), title], id=f'{name}-title')
    return html.Section([heading, *content], id=name, **{'aria-labelledby': f'{name}-title'})


def _numbered(titles: Sequence[str]) -> list[dict[str, Any]]:
    """Return the options of a menu of recordings: the browser knows them by number only."""
    return [{'label': title, 'value': number} for number, title in enumerate(titles)]


def _radio(name: str, options: dict[str, str], value: str, description: str) -> html.Div:
    choices = [{'label': label, 'value': key} for key, label in options.items()]
    return html.Div(
        dcc.RadioItems(id=name, options=choices, value=value, inline=True, className='choice'),
        role='radiogroup',
        **{'aria-label': description},
    )


def _graph(name: str, size: str) -> html.Div:
    graph = dcc.Graph(id=name, config=plot_config(name), style={'height': '100%'}, responsive=True)
    return html.Div(
        [html.P('', id=f'{name}-words', className='empty'), html.Div(graph, id=f'{name}-box', hidden=True)],
        className=f'figure {size}',
    )
