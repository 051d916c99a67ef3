"""Serves the page, to this machine only or to browsers that have the token.

The page needs no other server: all scripts are in installed packages, and the browser may load from this
server only. A browser cannot name files of this machine: it chooses recordings by number, revisions by known
labels and effects by names of the library; it can send recordings to a folder of their own (`uploads`).
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
from gyrocal_ros.studio.downloads import connect_downloads
from gyrocal_ros.studio.layout import layout
from gyrocal_ros.studio.uploads import connect_uploads
from gyrocal_ros.studio.workspace import Workspace

COOKIE = 'gyrocal_studio'
MAX_REQUEST_BYTES = 2**20
"""Largest body of a request; those of the page have a few kilobytes."""
POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; font-src 'self' data:; frame-ancestors 'none'; form-action 'self'"
)
TOKEN_PAGE = """<!doctype html><html lang="en"><meta charset="utf-8"><title>gyrocal studio</title>
<form><p><label>Token printed by the studio: <input name="token" type="password" autofocus></label>
<button>Open</button></p></form></html>"""


def make_app(workspace: Workspace, token: str | None = None, names: frozenset[str] | None = None) -> Dash:
    """Make the application of the page about recordings.

    Args:
        workspace: the recordings and the open session.
        token: token that every browser needs; None if no token is needed.
        names: host names that requests may use; None for any. This refuses pages of the internet whose
            name resolves to this machine (DNS rebinding).
    """
    app = _app(token, names)
    may_upload = token is None  # a browser on another machine does not fill this disk
    app.layout = lambda: layout(workspace.titles, may_upload=may_upload)
    connect(app, workspace)
    connect_downloads(app, workspace)
    if may_upload:
        connect_uploads(app, workspace)
    return app


def make_live_app(
    overview: Callable[[float], Overview], token: str | None = None, names: frozenset[str] | None = None
) -> Dash:
    """Make the application of the page about a running robot.

    Args:
        overview: returns everything received up to a time of the monotonic clock.
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
        suppress_callback_exceptions=True,  # the buttons of the effects are created at run time
        meta_tags=[{'name': 'viewport', 'content': 'width=device-width, initial-scale=1'}],
    )
    app.index_string = app.index_string.replace('<html>', '<html lang="en">')
    app.server.config['MAX_CONTENT_LENGTH'] = MAX_REQUEST_BYTES
    _control_access(app.server, token, names)
    return app


def is_loopback(host: str) -> bool:
    """Return True if an address can be reached from this machine only."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == 'localhost'


def new_token() -> str:
    """Return a random token."""
    return secrets.token_urlsafe(16)


def listen(app: Dash, host: str, port: int) -> BaseWSGIServer:
    """Make a server that listens but does not serve yet; port 0 takes any free port.

    Raises:
        GyrocalError: the address or the port cannot be used.
    """
    logging.getLogger('werkzeug').setLevel(logging.ERROR)
    try:
        return make_server(host, port, app.server, threaded=True)
    except (OSError, SystemExit) as error:  # werkzeug exits if the port is in use
        raise GyrocalError(
            'cannot be used', where=f'{host}:{port}', todo='choose another --port or --host'
        ) from error


def _control_access(server: Any, token: str | None, names: frozenset[str] | None) -> None:
    @server.before_request
    def check() -> Any:
        request = flask.request
        name = request.host.rpartition(':')[0] if ':' in request.host.rpartition(']')[2] else request.host
        if names is not None and name not in names:
            return flask.Response('The studio does not have this host name.', 403)
        origin = request.headers.get('Origin')
        if origin is not None and urlsplit(origin).netloc != request.host:
            return flask.Response('Requests from pages of other sites are refused.', 403)
        if token is None or _matches(request.cookies.get(COOKIE), token):
            return None
        if _matches(request.args.get('token'), token):
            answer = flask.redirect('/')
            answer.set_cookie(COOKIE, token, httponly=True, samesite='Strict')
            return answer
        return flask.Response(TOKEN_PAGE, 401, mimetype='text/html')

    @server.after_request
    def harden(answer: Any) -> Any:
        answer.headers['Content-Security-Policy'] = POLICY
        answer.headers['X-Content-Type-Options'] = 'nosniff'
        answer.headers['Referrer-Policy'] = 'no-referrer'
        return answer


def _matches(given: str | None, token: str) -> bool:
    return given is not None and hmac.compare_digest(given.encode(), token.encode())
