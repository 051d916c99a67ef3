"""What happens on the page: which part of it follows what, and what the buttons do."""

from __future__ import annotations

import time
from collections.abc import Callable
from threading import Thread
from typing import Any

from dash import ALL, ClientsideFunction, Dash, Input, Output, State, ctx, no_update

from gyrocal_ros.effects import EFFECTS
from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.studio import panels, pictures
from gyrocal_ros.studio.export import export
from gyrocal_ros.studio.layout import MARKS
from gyrocal_ros.studio.lesson import NOTHING, STRANGER
from gyrocal_ros.studio.state import StudioState
from gyrocal_ros.studio.workspace import Workspace

BUTTONS = ('add', 'undo', 'write', 'export', 'go-to', 'cancel', 'resume', 'riddle', 'reveal')
WAIT = 'The first run is under way.'
FORECAST_STEP = 10
"""How finely the progress of a trial in advance is shown, %."""


def connect(app: Dash, desk: Workspace) -> None:
    """Bring the page to life."""
    _follow(app, desk)
    _act(app, desk)
    _show_words(app, desk)
    _show_figures(app, desk)
    _compare(app, desk)
    app.clientside_callback(
        ClientsideFunction('studio', 'theme'),
        Output('theme', 'data'),
        Input('theme-button', 'n_clicks'),
        State('theme', 'data'),
    )


def marks(view: StudioState) -> dict[str, str]:
    """What each part of the page follows, as a text that changes when it has to be drawn anew."""
    ran = [trial.label for trial in view.trials.every if trial.examined is not None]
    model = f'{view.title} {view.trials.present} {ran}'
    so_far = '' if view.glimpse is None else f' {view.glimpse.time_s[-1]:.1f}'
    ahead = sorted(effect for label, effect in view.forecasts if label == view.trials.present)
    doing = view.doing
    if doing is not None and doing.what == 'forecast':
        ahead.append(f'{doing.subject} {int(100.0 * doing.advance.part) // FORECAST_STEP}')
    return {
        'session': view.title,
        'bag': f'{view.title} {view.contents is not None}',
        'model': model if ran else model + so_far,
        'missing': model,
        'forecast': f'{model} {ahead}',
        'lesson': f'{view.title} {view.has_answer} {view.revealed}',
    }


def _follow(app: Dash, desk: Workspace) -> None:
    """The state, asked for again and again."""

    @app.callback(
        Output('message', 'children'),
        Output('message', 'className'),
        Output('doing', 'children'),
        Output('progress', 'value'),
        Output('progress', 'hidden'),
        Output('cancel', 'hidden'),
        Output('resume', 'hidden'),
        Output('undo', 'disabled'),
        *(Output(name, 'disabled') for name in ('write', 'export', 'reveal')),
        *(Output(f'mark-{name}', 'data') for name in MARKS),
        Input('poll', 'n_intervals'),
        Input('acted', 'data'),
        *(State(f'mark-{name}', 'data') for name in MARKS),
    )
    def follow(_polled: Any, _acted: Any, *known: str | None) -> tuple[Any, ...]:
        view = desk.view
        doing, now = view.doing, view.trials.now
        has_run = view.examined is not None
        told = marks(view)
        changed = [
            no_update if told[name] == old else told[name] for name, old in zip(MARKS, known, strict=True)
        ]
        advance = None if doing is None else doing.advance
        return (
            view.message or panels.verdict(view),
            'trouble' if view.is_trouble else '',
            '' if advance is None else f'{advance.doing} {100.0 * advance.part:.0f} %',
            '0' if advance is None else f'{100.0 * advance.part:.0f}',
            doing is None,
            doing is None,
            doing is not None or (has_run and view.trials.waiting is None),
            view.is_busy or now is None or now.builds_on is None,
            *[not has_run] * 2,
            not (has_run and view.has_answer),
            *changed,
        )


def _act(app: Dash, desk: Workspace) -> None:
    """Buttons and choices that change the session."""

    @app.callback(
        Output('acted', 'data'),
        *(Input(name, 'n_clicks') for name in BUTTONS),
        Input('recording', 'value'),
        State('chosen', 'data'),
        State('right', 'value'),
        prevent_initial_call=True,
    )
    def act(*given: Any) -> float:
        number, chosen, right = given[len(BUTTONS) :]
        session = desk.session
        todo: dict[str, Callable[[], object]] = {
            'add': lambda: session.add(str(chosen)),
            'undo': session.undo,
            'write': session.write,
            'export': lambda: _export(desk),
            'go-to': lambda: session.go_to(str(right)),
            'cancel': session.cancel,
            'resume': session.resume,
            'riddle': desk.draw_riddle,
            'reveal': session.reveal,
            'recording': lambda: desk.choose(int(number)),
        }
        for name in _triggered():
            try:
                todo[str(name)]()
            except GyrocalError as error:
                session.say(str(error), is_trouble=True)
        return time.time()

    # Apart from the buttons: the page itself sets it when it opens, and a click must not wait for that.
    @app.callback(Input('guess', 'value'), prevent_initial_call=True)
    def guess(effect: str | None) -> None:
        desk.session.guess(effect)

    @app.callback(
        Output('chosen', 'data'),
        Input({'do': 'choose', 'effect': ALL}, 'n_clicks'),
        Input('evidence-figure', 'clickData'),
        Input('mark-missing', 'data'),
        State('chosen', 'data'),
    )
    def choose(_clicks: list[Any], drawn: Any, _mark: Any, chosen: str | None) -> str | None:
        now = desk.view.examined
        if now is None:
            return None
        names = [choice.effect.name for choice in panels.choices(now)]
        wanted = chosen
        for name in _triggered():
            if isinstance(name, dict):
                wanted = str(name['effect'])
            elif name == 'evidence-figure':
                wanted = str(drawn['points'][0]['y']).replace('<br>', '')
        if wanted not in names:
            wanted = None if now.best is None else now.best.effect.name
        if wanted is not None:
            try:
                desk.session.forecast(wanted)
            except GyrocalError as error:
                desk.session.say(str(error), is_trouble=True)
        return wanted


def _triggered() -> list[Any]:
    """The ids of all that a callback answers to: a busy browser sends what came together as one."""
    ids = ctx.triggered_prop_ids
    return [ids[one['prop_id']] for one in ctx.triggered if one['value'] is not None]


def _export(desk: Workspace) -> None:
    """Write the report while the page goes on."""
    session, view = desk.session, desk.view

    def work() -> None:
        try:
            session.say(export(view, session.folder))
        except GyrocalError as error:
            session.say(str(error), is_trouble=True)

    session.say('Writing the report ...')
    Thread(target=work, name='report').start()


def _show_words(app: Dash, desk: Workspace) -> None:
    @app.callback(Output('title', 'children'), Input('mark-session', 'data'))
    def title(_mark: Any) -> str:
        return desk.view.title

    @app.callback(Output('bag-words', 'children'), Input('mark-bag', 'data'))
    def bag(_mark: Any) -> Any:
        return panels.bag(desk.view)

    @app.callback(
        Output('verdict', 'children'),
        Output('candidates', 'children'),
        Output('failures', 'children'),
        Output('revisions', 'children'),
        Input('mark-missing', 'data'),
    )
    def missing(_mark: Any) -> Any:
        view = desk.view
        words = panels.verdict(view) or WAIT
        return words, panels.candidate_list(view), panels.failures(view), panels.revision_table(view)

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
        view = desk.view
        words = 'Add to the model' if chosen is None else f'Add {chosen}'
        return panels.candidate_card(view, chosen), chosen is None or view.is_busy, words

    @app.callback(Output('guess', 'value'), Input('mark-session', 'data'))
    def guessed(_mark: Any) -> str | None:
        return desk.view.guess

    @app.callback(
        Output('truth-words', 'children'),
        Output('guess', 'options'),
        Input('mark-lesson', 'data'),
        Input('mark-missing', 'data'),
    )
    def lesson(_mark: Any, _model: Any) -> Any:
        view = desk.view
        followers = [] if view.examined is None else view.examined.stage.ranked
        covariates = [one.effect.name for one in followers if ':' in one.effect.name]
        return panels.lesson(view), [NOTHING, STRANGER, *EFFECTS, *sorted(covariates)]


def _show_figures(app: Dash, desk: Workspace) -> None:
    @app.callback(*_figure('model-figure'), Input('mark-model', 'data'), Input('kind', 'value'))
    def model(mark: str, kind: str) -> Any:
        view = desk.view
        figure = pictures.against_measurement(view, kind)
        return _shown(figure, 'The recording is too short for that.' if view.trials.every else WAIT, kind)

    @app.callback(
        Output('signal', 'options'),
        Output('signal', 'value'),
        Input('mark-missing', 'data'),
        State('signal', 'value'),
    )
    def signals(_mark: Any, chosen: str | None) -> Any:
        found = pictures.signals(desk.view)
        options = [
            {'label': f'{signal} - {_kind(of_scale)}', 'value': f'{_kind(of_scale)}:{signal}'}
            for signal, of_scale in found
        ]
        values = [option['value'] for option in options]
        return options, chosen if chosen in values else next(iter(values), None)

    @app.callback(*_figure('residual-figure'), Input('signal', 'value'), Input('mark-missing', 'data'))
    def residual(chosen: str | None, _mark: Any) -> Any:
        kind, _, signal = (chosen or '').partition(':')
        figure = pictures.left_over(desk.view, signal, kind == 'scale') if chosen else None
        return _shown(figure, 'This recording cannot tell.' if chosen else WAIT, chosen)

    @app.callback(*_figure('evidence-figure'), Input('mark-missing', 'data'))
    def scores(_mark: Any) -> Any:
        return _shown(pictures.scores(desk.view), WAIT)

    @app.callback(*_figure('history-figure'), Input('mark-missing', 'data'))
    def history(_mark: Any) -> Any:
        view = desk.view
        words = 'No span of a minute is left for the drift.' if view.improvement else WAIT
        return _shown(pictures.revisions(view), words)


def _compare(app: Dash, desk: Workspace) -> None:
    @app.callback(
        Output('left', 'options'),
        Output('left', 'value'),
        Output('right', 'options'),
        Output('right', 'value'),
        Input('mark-missing', 'data'),
        State('left', 'value'),
        State('right', 'value'),
    )
    def offered(_mark: Any, left: str | None, _right: str | None) -> Any:
        trials = desk.view.trials
        labels = [trial.label for trial in trials.every if trial.examined is not None]
        first = left if left in labels else next(iter(labels), None)
        return labels, first, labels, trials.present if trials.present in labels else None

    @app.callback(
        *_figure('compare-figure'),
        Input('left', 'value'),
        Input('right', 'value'),
        Input('compare-kind', 'value'),
    )
    def compared(left: str | None, right: str | None, kind: str) -> Any:
        if left is None or right is None or left == right:
            return _shown(None, 'Choose two revisions.')
        return _shown(pictures.side_by_side(desk.view, (left, right), kind), 'One of them has to run first.')


def _figure(name: str) -> tuple[Output, Output, Output]:
    return Output(name, 'figure'), Output(f'{name}-box', 'hidden'), Output(f'{name}-words', 'children')


def _shown(figure: Any | None, words: str, kept_while: str | None = None) -> tuple[Any, bool, str]:
    """A figure that fills its place, or words; zoomed as before while `kept_while` is the same."""
    if figure is None:
        return no_update, True, words
    figure.update_layout(height=None, autosize=True, uirevision=kept_while, font_size=12)
    figure.update_layout(margin_t=60, margin_b=40, title_font_size=14)
    figure.update_yaxes(title_font_size=10, title_standoff=4)
    return figure, False, ''


def _kind(of_scale: bool) -> str:
    return 'scale' if of_scale else 'bias'
