"""Download links of an exported report. A browser can name the files of `FILES` only."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import flask
from dash import Dash, Input, Output, html

from gyrocal_ros.studio.export import ARCHIVE, NAME, PDF
from gyrocal_ros.studio.workspace import Workspace

FILES = {'report.zip': Path(ARCHIVE), 'report.pdf': Path(NAME) / PDF}
"""Place in the folder of a session, by name in the address."""
ROUTE = '/download/'


def connect_downloads(app: Dash, workspace: Workspace) -> None:
    """Serve the exported files of the open session, and show links to those that exist."""

    @app.server.route(f'{ROUTE}<name>')
    def download(name: str) -> Any:
        place = FILES.get(name)
        path = None if place is None else workspace.session.folder.resolve() / place
        if path is None or not path.is_file():
            return flask.Response('This session has no such file: export the report first.', 404)
        title = workspace.state.title
        return flask.send_file(path, as_attachment=True, download_name=f'{title}_{name}', max_age=0)

    # The end of an export shows a message.
    @app.callback(Output('downloads', 'children'), Input('message', 'children'))
    def links(_message: Any) -> list[Any]:
        folder = workspace.session.folder
        found = [name for name, place in FILES.items() if (folder / place).is_file()]
        return [html.A(f'Download {name}', href=f'{ROUTE}{name}', download='') for name in found]
