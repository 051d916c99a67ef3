"""Callbacks of the page: updates of its parts, and the actions of its buttons."""

from __future__ import annotations

import time
from collections.abc import Callable
from threading import Thread
from typing import Any

from dash import ALL, ClientsideFunction, Dash, Input, Output, State, ctx, no_update
from dash.exceptions import PreventUpdate

from gyrocal_ros.diagnose.analysis.shapes import TIME
from gyrocal_ros.effects import EFFECTS
from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.studio import panels, pictures
from gyrocal_ros.studio.export import export
from gyrocal_ros.studio.layout import IDLE_POLL_MS, MARKS, POLL_MS
from gyrocal_ros.studio.lesson import NOTHING, UNKNOWN
from gyrocal_ros.studio.state import StudioState
from gyrocal_ros.studio.workspace import Workspace

BUTTONS = (
    *('add', 'learn', 'undo', 'write', 'export', 'validate', 'go-to', 'cancel', 'resume', 'riddle'),
    'reveal',
)
WAIT = 'The first run is in progress.'
FORECAST_STEP = 10
"""Step in which the progress of a run in advance is shown, %."""


def connect(app: Dash, workspace: Workspace) -> None:
    """Connect the page to the workspace."""
    _connect_status(app, workspace)
    _connect_actions(app, workspace)
    _connect_texts(app, workspace)
    _connect_figures(app, workspace)
    _connect_comparison(app, workspace)
    app.clientside_callback(
        ClientsideFunction('studio', 'theme'),
        Output('theme', 'data'),
        Input('theme-button', 'n_clicks'),
        State('theme', 'data'),
    )
    app.clientside_callback(
        ClientsideFunction('studio', 'zoom'),
        *(Input(f'{name}-figure', 'relayoutData') for name in ('model', 'residual', 'compare')),
        prevent_initial_call=True,
    )


def marks(state: StudioState) -> dict[str, str]:
    """Return a text for each part of the page, which changes when that part has to be drawn again."""
    ran = [tried.label for tried in state.tree.models if tried.examination is not None]
    model = f'{state.title} {state.tree.present_label} {ran}'
    truth = ' revealed' if state.revealed is not None else ''
    preview = '' if state.preview is None else f' {state.preview.time_s[-1]:.1f}'
    forecasts = sorted(effect for label, effect in state.forecasts if label == state.tree.present_label)
    validated = [(recording, *models) for recording, models in state.validated.items()]
    running = state.running
    if running is not None and running.kind == 'forecast':
        forecasts.append(f'{running.subject} {int(100.0 * running.progress.fraction) // FORECAST_STEP}')
    return {
        'session': state.title,
        'bag': f'{state.title} {state.contents is not None}',
        'model': model + truth if ran else model + preview,
        'missing': f'{model} {sorted(state.learned)}',
        'forecast': f'{model} {forecasts}',
        'validation': f'{state.title} {validated}',
        'lesson': f'{state.title} {state.has_answer} {state.revealed}',
    }


def _connect_status(app: Dash, workspace: Workspace) -> None:
    """Update the status line, and the marks that the other parts of the page depend on."""

    @app.callback(
        Output('message', 'children'),
        Output('message', 'className'),
        Output('doing', 'children'),
        Output('progress', 'value'),
        Output('progress', 'hidden'),
        Output('cancel', 'hidden'),
        Output('resume', 'hidden'),
        Output('undo', 'disabled'),
        Output('learn', 'disabled'),
        *(Output(name, 'disabled') for name in ('write', 'export', 'reveal')),
        *(Output(f'mark-{name}', 'data') for name in MARKS),
        Output('poll', 'interval'),
        Output('shown', 'data'),
        Input('poll', 'n_intervals'),
        Input('acted', 'data'),
        State('shown', 'data'),
    )
    def update(_polled: Any, _acted: Any, shown: list[str | int] | None) -> list[Any]:
        parts = status_parts(workspace.state)
        if parts == shown:
            raise PreventUpdate  # what is sent again is drawn again
        before: list[Any] = shown or [None] * len(parts)
        return [*(no_update if new == old else new for new, old in zip(parts, before, strict=True)), parts]


def status_parts(state: StudioState) -> list[str | int]:
    """Return message, its class, progress, what is hidden and disabled, the marks, and the next period."""
    running, present = state.running, state.tree.present
    has_run, status = state.examination is not None, panels.status(state)
    progress = None if running is None else running.progress
    return [
        state.message or ('' if status is None else status.sentence),
        'error-message' if state.is_error else '' if status is None else status.level,
        '' if progress is None else f'{progress.text} {100.0 * progress.fraction:.0f} %',
        '0' if progress is None else f'{100.0 * progress.fraction:.0f}',
        running is None,
        running is None,
        running is not None or (has_run and state.tree.next_to_run is None),
        state.is_busy or present is None or present.builds_on is None,
        state.is_busy or not state.can_learn,
        *[not has_run] * 2,
        not (has_run and state.has_answer),
        *marks(state).values(),
        IDLE_POLL_MS if running is None else POLL_MS,
    ]


def _connect_actions(app: Dash, workspace: Workspace) -> None:
    """Connect the buttons and choices that change the session."""

    @app.callback(
        Output('acted', 'data'),
        *(Input(name, 'n_clicks') for name in BUTTONS),
        Input('recording', 'value'),
        State('chosen', 'data'),
        State('right', 'value'),
        State('other', 'value'),
        prevent_initial_call=True,
    )
    def act(*given: Any) -> float:
        number, chosen, right, other = given[len(BUTTONS) :]
        session = workspace.session
        actions: dict[str, Callable[[], object]] = {
            'add': lambda: session.add(str(chosen)),
            'learn': session.learn,
            'undo': session.undo,
            'write': session.write,
            'export': lambda: _export(workspace),
            'validate': lambda: workspace.validate_on(-1 if other is None else int(other)),
            'go-to': lambda: session.go_to(str(right)),
            'cancel': session.cancel,
            'resume': session.resume,
            'riddle': workspace.draw_task,
            'reveal': session.reveal,
            'recording': lambda: workspace.choose(int(number)),
        }
        for name in _triggered():
            try:
                actions[str(name)]()
            except GyrocalError as error:
                session.show_message(str(error), is_error=True)
        return time.time()

    # Not with the buttons: the page sets it when it opens, and a click must not wait for that.
    @app.callback(Input('guess', 'value'), prevent_initial_call=True)
    def guess(effect: str | None) -> None:
        workspace.session.guess(effect)

    @app.callback(
        Output('chosen', 'data'),
        Input({'do': 'choose', 'effect': ALL}, 'n_clicks'),
        Input('evidence-figure', 'clickData'),
        Input('mark-missing', 'data'),
        State('chosen', 'data'),
    )
    def choose(_clicks: list[Any], point: Any, _mark: Any, chosen: str | None) -> str | None:
        state = workspace.state
        examination, proposal = state.examination, state.proposal
        if examination is None:
            return None
        names = [choice.effect.name for choice in panels.choices(state)]
        for name in _triggered():
            if isinstance(name, dict):
                chosen = str(name['effect'])
            elif name == 'evidence-figure':
                chosen = str(point['points'][0]['y']).replace('<br>', '')
            elif name == 'mark-missing' and proposal is not None:
                chosen = proposal.name
        if chosen not in names:
            chosen = None if examination.best is None else examination.best.effect.name
        if chosen is not None:
            try:
                workspace.session.forecast(chosen)
            except GyrocalError as error:
                workspace.session.show_message(str(error), is_error=True)
        return chosen


def _triggered() -> list[Any]:
    """Return the ids of all triggers of a callback: a busy browser sends several clicks as one request."""
    ids = ctx.triggered_prop_ids
    return [ids[one['prop_id']] for one in ctx.triggered if one['value'] is not None]


def _export(workspace: Workspace) -> None:
    """Write the report in a thread, so that the page stays responsive."""
    session, state = workspace.session, workspace.state

    def work() -> None:
        try:
            session.show_message(export(state, session.folder))
        except GyrocalError as error:
            session.show_message(str(error), is_error=True)

    session.show_message('Writing the report ...')
    Thread(target=work, name='report').start()


def _connect_texts(app: Dash, workspace: Workspace) -> None:
    @app.callback(Output('title', 'children'), Input('mark-session', 'data'))
    def title(_mark: Any) -> str:
        return workspace.state.title

    @app.callback(Output('bag-words', 'children'), Input('mark-bag', 'data'))
    def recording(_mark: Any) -> Any:
        return panels.recording(workspace.state)

    @app.callback(
        Output('verdict', 'children'),
        Output('candidates', 'children'),
        Output('failures', 'children'),
        Output('revisions', 'children'),
        Input('mark-missing', 'data'),
    )
    def missing(_mark: Any) -> Any:
        state = workspace.state
        status = panels.status(state)
        verdict = WAIT if status is None else f'{status.sentence} {status.next_step}'.strip()
        return verdict, panels.candidate_list(state), panels.failures(state), panels.revision_table(state)

    @app.callback(
        Output({'do': 'choose', 'effect': ALL}, 'aria-pressed'),
        Input('chosen', 'data'),
        Input('candidates', 'children'),
        State({'do': 'choose', 'effect': ALL}, 'id'),
    )
    def pressed(chosen: str | None, _list: Any, ids: list[dict[str, str]]) -> list[str]:
        return ['true' if one['effect'] == chosen else 'false' for one in ids]

    @app.callback(
        Output('card', 'children'),
        Output('add', 'disabled'),
        Output('add', 'children'),
        Input('chosen', 'data'),
        Input('mark-forecast', 'data'),
        Input('acted', 'data'),
    )
    def card(chosen: str | None, _mark: Any, _acted: Any) -> Any:
        state = workspace.state
        label = 'Add to the model' if chosen is None else f'Add {chosen}'
        return panels.candidate_card(state, chosen), chosen is None or state.is_busy, label

    @app.callback(Output('validation', 'children'), Input('mark-validation', 'data'))
    def validation(_mark: Any) -> Any:
        return panels.validations(workspace.state)

    @app.callback(Output('guess', 'value'), Input('mark-session', 'data'))
    def stored_guess(_mark: Any) -> str | None:
        return workspace.state.guess

    @app.callback(
        Output('truth-words', 'children'),
        Output('guess', 'options'),
        Input('mark-lesson', 'data'),
        Input('mark-missing', 'data'),
    )
    def lesson(_mark: Any, _model: Any) -> Any:
        state = workspace.state
        examination = state.examination
        ranked = [] if examination is None else examination.examined.ranked
        covariates = [one.effect.name for one in ranked if ':' in one.effect.name]
        return panels.lesson(state), [NOTHING, UNKNOWN, *EFFECTS, *sorted(covariates)]


def _connect_figures(app: Dash, workspace: Workspace) -> None:
    @app.callback(*_figure('model-figure'), Input('mark-model', 'data'), Input('kind', 'value'))
    def model(mark: str, kind: str) -> Any:
        state = workspace.state
        figure = pictures.against_measurement(state, kind)
        text = 'The recording is too short.' if state.tree.models else WAIT
        return _figure_or_text(_linked(figure, state, TIME), text, kind)

    @app.callback(
        Output('signal', 'options'),
        Output('signal', 'value'),
        Input('mark-missing', 'data'),
        Input('chosen', 'data'),
        State('signal', 'value'),
    )
    def signals(_mark: Any, effect: str | None, chosen: str | None) -> Any:
        found = pictures.signals(workspace.state)
        options = [
            {'label': f'{signal} - {_kind(of_scale)}', 'value': f'{_kind(of_scale)}:{signal}'}
            for signal, of_scale in found
        ]
        values = [option['value'] for option in options]
        axis = pictures.axis_of(workspace.state, effect)
        if axis is not None and 'chosen' in _triggered():
            return options, f'{_kind(axis[1])}:{axis[0]}'
        return options, chosen if chosen in values else next(iter(values), None)

    @app.callback(
        *_figure('residual-figure'),
        Input('signal', 'value'),
        Input('chosen', 'data'),
        Input('mark-missing', 'data'),
    )
    def residual(chosen: str | None, effect: str | None, _mark: Any) -> Any:
        kind, _, signal = (chosen or '').partition(':')
        state, of_scale = workspace.state, kind == 'scale'
        figure = pictures.error_by_signal(state, signal, of_scale, effect) if chosen else None
        if figure is not None:
            figure.update_layout(title_text='')  # the choice above says it, and the legend needs the place
            figure = _linked(figure, state, signal)
        text = 'Not known from this recording.' if chosen else WAIT
        return _figure_or_text(figure, text, chosen)

    @app.callback(*_figure('evidence-figure'), Input('mark-missing', 'data'))
    def scores(_mark: Any) -> Any:
        return _figure_or_text(pictures.scores(workspace.state), WAIT)

    @app.callback(*_figure('history-figure'), Input('mark-missing', 'data'))
    def history(_mark: Any) -> Any:
        state = workspace.state
        text = 'The recording has no held-out span of a minute.' if state.improvement else WAIT
        return _figure_or_text(pictures.revisions(state), text)


def _connect_comparison(app: Dash, workspace: Workspace) -> None:
    @app.callback(
        Output('left', 'options'),
        Output('left', 'value'),
        Output('right', 'options'),
        Output('right', 'value'),
        Input('mark-missing', 'data'),
        State('left', 'value'),
        State('right', 'value'),
    )
    def options(_mark: Any, left: str | None, _right: str | None) -> Any:
        tree = workspace.state.tree
        labels = [tried.label for tried in tree.models if tried.examination is not None]
        first = left if left in labels else next(iter(labels), None)
        return labels, first, labels, tree.present_label if tree.present_label in labels else None

    @app.callback(
        *_figure('compare-figure'),
        Input('left', 'value'),
        Input('right', 'value'),
        Input('compare-kind', 'value'),
    )
    def compared(left: str | None, right: str | None, kind: str) -> Any:
        if left is None or right is None or left == right:
            return _figure_or_text(None, 'Choose two revisions.')
        figure = pictures.side_by_side(workspace.state, (left, right), kind)
        if kind != 'coefficients':  # they are drawn by model
            figure = _linked(figure, workspace.state, TIME)
        return _figure_or_text(figure, 'One of them has not run yet.', kind)


def _figure(name: str) -> tuple[Output, Output, Output]:
    return Output(name, 'figure'), Output(f'{name}-box', 'hidden'), Output(f'{name}-words', 'children')


def _linked(figure: Any | None, state: StudioState, axis: str) -> Any | None:
    """Name the horizontal axis, so that the page zooms all figures that share it, and marks places on it."""
    if figure is not None:
        figure.update_layout(meta={'axis': axis})
        figure.update_xaxes(uirevision=f'{state.title} {axis}')
    return figure


def _figure_or_text(figure: Any | None, text: str, zoom_key: str | None = None) -> tuple[Any, bool, str]:
    """Return a figure that fills its place, or a text; the zoom is kept while `zoom_key` is the same."""
    if figure is None:
        return no_update, True, text
    figure.update_layout(height=None, autosize=True, uirevision=zoom_key, font_size=12)
    figure.update_layout(margin_t=60, margin_b=40, title_font_size=14)
    figure.update_yaxes(title_font_size=10, title_standoff=4)
    return figure, False, ''


def _kind(of_scale: bool) -> str:
    return 'scale' if of_scale else 'bias'
