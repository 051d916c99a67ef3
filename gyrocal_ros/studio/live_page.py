"""The page about a running robot: scale factor with its band, innovations, tracks and health."""

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
LEVEL_TEXT = {Level.OK: '✓ ok', Level.WARN: '! warning', Level.ERROR: '✗ error'}
NO_MESSAGES = 'No message yet. Is the calibrator running, in the same ROS_DOMAIN_ID and namespace?'


def layout() -> html.Div:
    """Return the page."""
    graph = dcc.Graph(id='live-figure', config=plot_config('live'), style={'height': '100%'}, responsive=True)
    return html.Div(
        [
            dcc.Interval(id='poll', interval=POLL_MS),
            dcc.Store(id='shown'),
            html.Header(
                [
                    html.Div([html.H1(['gyrocal studio ', html.Span('live')])], className='top'),
                    html.Div(html.Div(NO_MESSAGES, id='message', role='status'), className='status'),
                ]
            ),
            html.Main(
                [
                    html.Section(
                        [html.H2('Estimate'), html.Div(html.Div(graph), className='figure tall')],
                        id='model',
                    ),
                    html.Section([html.H2('Tracked features'), html.Div(id='tracks')], id='residual'),
                    html.Section([html.H2('Health of the nodes'), html.Div(id='nodes')], id='bag'),
                ]
            ),
        ]
    )


def connect(app: Dash, overview: Callable[[float], Overview]) -> None:
    """Update the page with the messages of the robot.

    Args:
        app: the page.
        overview: returns everything received up to a time of the monotonic clock.
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
    def update(_polled: Any, shown: int | None) -> tuple[Any, ...]:
        received = overview(time.monotonic())
        if not received.version:
            return (no_update,) * 5
        nodes = _nodes(received.nodes)
        if received.version == shown:
            return shown, no_update, no_update, no_update, nodes
        figure = live(
            received.time_s,
            received.scale_factor,
            received.scale_factor_std,
            received.nis_time_s,
            received.nis,
        )
        figure.update_layout(height=None, autosize=True, uirevision='live')
        return received.version, _estimate_text(received), figure, _tracks(received.tracks), nodes


def _estimate_text(received: Overview) -> str:
    if not len(received.time_s):
        return 'No calibration received yet.'
    scale = with_std(float(received.scale_factor[-1]), float(received.scale_factor_std[-1]))
    converged = 'converged' if received.calibration.get('gyro.converged') else 'not converged yet'
    return f'Scale factor {scale}, {converged}; model {received.calibration.get("gyro.model", "")}.'


def _tracks(jpeg: bytes | None) -> Any:
    if jpeg is None:
        return html.P('No image: the tracker is not running, or receives none.', className='empty')
    source = f'data:image/jpeg;base64,{base64.b64encode(jpeg).decode()}'
    return html.Img(src=source, alt='Image of the ceiling with the tracks', style={'width': '100%'})


def _nodes(nodes: tuple[NodeHealth, ...]) -> Any:
    rows = [
        html.Tr(
            [
                html.Th(node.name, scope='row'),
                html.Td('silent' if node.is_gone else LEVEL_TEXT[node.level]),
                html.Td(f'no message for {node.silent_s:.0f} s' if node.is_gone else node.message),
                html.Td(_values(node)),
            ]
        )
        for node in nodes
    ]
    heads = html.Tr([html.Th(head, scope='col') for head in ('node', 'level', 'status', 'values')])
    return html.Div(html.Table([html.Thead(heads), html.Tbody(rows)]), className='wide')


def _values(node: NodeHealth) -> Any:
    text = ', '.join(f'{name} {value}' for name, value in node.numbers.items())
    return html.Details([html.Summary(f'{len(node.numbers)}'), html.Span(text, className='note')])
