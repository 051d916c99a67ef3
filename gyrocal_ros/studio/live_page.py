"""The page about a running robot: its scale factor with the band, its innovations, tracks and health."""

from __future__ import annotations

import base64
import time
from collections.abc import Callable
from typing import Any

from dash import Dash, Input, Output, State, dcc, html, no_update

from gyrocal_ros.report.calibration_figures import live
from gyrocal_ros.report.describe import with_std
from gyrocal_ros.report.plot import plot_config
from gyrocal_ros.robot.feed import NodeHealth, Overview
from gyrocal_ros.robot.health import Level

POLL_MS = 1000
SIGNS = {Level.OK: '✓ well', Level.WARN: '! beware', Level.ERROR: '✗ wrong'}
NOBODY = 'Nothing has been heard yet. Does the calibrator run, in the same ROS_DOMAIN_ID and namespace?'


def layout() -> html.Div:
    """The whole page."""
    graph = dcc.Graph(id='live-figure', config=plot_config('live'), style={'height': '100%'}, responsive=True)
    return html.Div(
        [
            dcc.Interval(id='poll', interval=POLL_MS),
            dcc.Store(id='shown'),
            html.Header(
                [
                    html.Div([html.H1(['gyrocal studio ', html.Span('live')])], className='top'),
                    html.Div(html.Div(NOBODY, id='message', role='status'), className='status'),
                ]
            ),
            html.Main(
                [
                    html.Section(
                        [html.H2('The estimate'), html.Div(html.Div(graph), className='figure tall')],
                        id='model',
                    ),
                    html.Section([html.H2('What the tracker sees'), html.Div(id='tracks')], id='residual'),
                    html.Section([html.H2('How the nodes are'), html.Div(id='nodes')], id='bag'),
                ]
            ),
        ]
    )


def connect(app: Dash, overview: Callable[[float], Overview]) -> None:
    """Let the page follow what is heard.

    Args:
        app: the page.
        overview: what was heard up to a moment of the monotonic clock.
    """

    @app.callback(
        Output('shown', 'data'),
        Output('message', 'children'),
        Output('live-figure', 'figure'),
        Output('tracks', 'children'),
        Output('nodes', 'children'),
        Input('poll', 'n_intervals'),
        State('shown', 'data'),
    )
    def follow(_polled: Any, shown: int | None) -> tuple[Any, ...]:
        heard = overview(time.monotonic())
        if not heard.version:
            return (no_update,) * 5
        nodes = _nodes(heard.nodes)
        if heard.version == shown:
            return shown, no_update, no_update, no_update, nodes
        figure = live(heard.time_s, heard.scale_factor, heard.scale_factor_std, heard.nis_time_s, heard.nis)
        figure.update_layout(height=None, autosize=True, uirevision='live')
        return heard.version, _in_words(heard), figure, _tracks(heard.tracks), nodes


def _in_words(heard: Overview) -> str:
    if not len(heard.time_s):
        return 'No calibration has been told yet.'
    scale = with_std(float(heard.scale_factor[-1]), float(heard.scale_factor_std[-1]))
    converged = 'converged' if heard.calibration.get('gyro.converged') else 'not converged yet'
    return f'Scale factor {scale}, {converged}; model {heard.calibration.get("gyro.model", "")}.'


def _tracks(jpeg: bytes | None) -> Any:
    if jpeg is None:
        return html.P('No image: the tracker is not running, or sees none.', className='empty')
    source = f'data:image/jpeg;base64,{base64.b64encode(jpeg).decode()}'
    return html.Img(src=source, alt='The ceiling with the tracks drawn', style={'width': '100%'})


def _nodes(nodes: tuple[NodeHealth, ...]) -> Any:
    rows = [
        html.Tr(
            [
                html.Th(node.name, scope='row'),
                html.Td('silent' if node.is_gone else SIGNS[node.level]),
                html.Td(f'nothing for {node.silent_s:.0f} s' if node.is_gone else node.message),
                html.Td(_numbers(node)),
            ]
        )
        for node in nodes
    ]
    heads = html.Tr([html.Th(head, scope='col') for head in ('node', '', 'says', 'numbers')])
    return html.Div(html.Table([html.Thead(heads), html.Tbody(rows)]), className='wide')


def _numbers(node: NodeHealth) -> Any:
    words = ', '.join(f'{name} {value}' for name, value in node.numbers.items())
    return html.Details([html.Summary(f'{len(node.numbers)}'), html.Span(words, className='note')])
