"""Serves the page, and guards it: to this machine alone, or to those who have the token.

Nothing comes from elsewhere: all scripts lie in installed packages, and the browser is told to load
from here only. A browser can name no file: recordings go by number, revisions by the labels that are
known, effects by names of the library.
"""

from __future__ import annotations

import hmac
import ipaddress
import logging
import secrets
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import flask
from dash import Dash
from werkzeug.serving import BaseWSGIServer, make_server

from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.robot.feed import Overview
from gyrocal_ros.studio import live_page
from gyrocal_ros.studio.callbacks import connect
from gyrocal_ros.studio.layout import layout
from gyrocal_ros.studio.workspace import Workspace

COOKIE = 'gyrocal_studio'
POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; font-src 'self' data:; frame-ancestors 'none'; form-action 'self'"
)
DOOR = """<!doctype html><html lang="en"><meta charset="utf-8"><title>gyrocal studio</title>
<form><p><label>The token that the studio printed: <input name="token" type="password" autofocus></label>
<button>Open</button></p></form></html>"""


def make_app(desk: Workspace, token: str | None = None, names: frozenset[str] | None = None) -> Dash:
    """The page about recordings as an application.

    Args:
        desk: what it shows.
        token: asked of every browser; None to let this machine's in.
        names: of the host by which it may be called; any where None. A page of the internet that
            makes its own name point here is so turned away.
    """
    app = _app(token, names)
    app.layout = lambda: layout(desk.titles)
    connect(app, desk)
    return app


def make_live_app(
    overview: Callable[[float], Overview], token: str | None = None, names: frozenset[str] | None = None
) -> Dash:
    """The page about a running robot as an application.

    Args:
        overview: what was heard of it, up to a moment of the monotonic clock.
        token: as in `make_app`.
        names: as in `make_app`.
    """
    app = _app(token, names)
    app.layout = live_page.layout
    live_page.connect(app, overview)
    return app


def _app(token: str | None, names: frozenset[str] | None) -> Dash:
    app = Dash(
        __name__,
        title='gyrocal studio',
        update_title=None,
        serve_locally=True,
        assets_folder=str(Path(__file__).parent / 'assets'),
        suppress_callback_exceptions=True,  # the buttons of the effects come and go
        meta_tags=[{'name': 'viewport', 'content': 'width=device-width, initial-scale=1'}],
    )
    _guard(app.server, token, names)
    return app


def is_loopback(host: str) -> bool:
    """Whether an address is reached from this machine alone."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == 'localhost'


def new_token() -> str:
    """A token that nobody guesses."""
    return secrets.token_urlsafe(16)


def listen(app: Dash, host: str, port: int) -> BaseWSGIServer:
    """A server that listens but does not serve yet; port 0 takes any that is free.

    Raises:
        GyrocalError: the address or the port cannot be had.
    """
    logging.getLogger('werkzeug').setLevel(logging.ERROR)
    try:
        return make_server(host, port, app.server, threaded=True)
    except (OSError, SystemExit) as error:  # werkzeug exits where a port is taken
        raise GyrocalError(
            'cannot be listened on', where=f'{host}:{port}', todo='choose another --port'
        ) from error


def _guard(server: Any, token: str | None, names: frozenset[str] | None) -> None:
    @server.before_request
    def check() -> Any:
        request = flask.request
        called = request.host.rpartition(':')[0] if ':' in request.host.rpartition(']')[2] else request.host
        if names is not None and called not in names:
            return flask.Response('This name is not that of the studio.', 403)
        origin = request.headers.get('Origin')
        if origin is not None and urlsplit(origin).netloc != request.host:
            return flask.Response('The page of another site may not speak here.', 403)
        if token is None or _matches(request.cookies.get(COOKIE), token):
            return None
        if _matches(request.args.get('token'), token):
            answer = flask.redirect('/')
            answer.set_cookie(COOKIE, token, httponly=True, samesite='Strict')
            return answer
        return flask.Response(DOOR, 401, mimetype='text/html')

    @server.after_request
    def harden(answer: Any) -> Any:
        answer.headers['Content-Security-Policy'] = POLICY
        answer.headers['X-Content-Type-Options'] = 'nosniff'
        answer.headers['Referrer-Policy'] = 'no-referrer'
        return answer


def _matches(given: str | None, token: str) -> bool:
    return given is not None and hmac.compare_digest(given.encode(), token.encode())
