"""Find missing effects on a web page: see where the model fails, add an effect, see the error fall.

Give bags, folders of bags, or folders of `gyrocal fleet run`, whose bags are listed with those of the most
unusual robot first; the default is the bags of the package. The first bag is opened, the page can open the
others, and a model that was fitted on one bag can be tested on another: another day, or another robot. A bag
that is dropped on the page is copied to OUT/uploads and opened. No other file is read. Every model that you
try is saved in a folder OUT/BAG, in the format of `gyrocal improve`, so a reload or a killed server loses
nothing; run the same command again to continue.
"""

from __future__ import annotations

import argparse
import sys
import webbrowser
from collections import Counter
from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from threading import Timer
from typing import Any

from gyrocal_ros.bag.storage import bags_in, is_bag
from gyrocal_ros.cli.fleet import require_extra
from gyrocal_ros.cli.model_options import add_model_options, read_model
from gyrocal_ros.cli.numbers import whole_number
from gyrocal_ros.cli.options import add_images_option, add_topic_options, bag_options, read_config
from gyrocal_ros.cli.output import print_message, warn
from gyrocal_ros.errors import GyrocalError, RecordingError
from gyrocal_ros.files import shipped
from gyrocal_ros.studio.recordings import Bag
from gyrocal_ros.studio.worker import Worker

EXAMPLE = """gyrocal studio my_bag
gyrocal studio monday tuesday
gyrocal studio my_bags --model model.yaml -o results
gyrocal studio my_fleet
gyrocal studio --lesson 7
gyrocal studio --live"""

PORT = 8350
BROWSER_DELAY_S = 0.5
"""Time after which the browser is opened, when the server is ready."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        'bags', type=Path, nargs='*', metavar='BAG', help='bags, folders of bags, or folders of fleets'
    )
    add_topic_options(parser)
    add_images_option(parser)
    add_model_options(parser)
    parser.add_argument(
        '-o', '--out', type=Path, default=Path('gyrocal_studio'), help='folder for the results (%(default)s)'
    )
    parser.add_argument(
        '--lesson',
        type=whole_number(0),
        metavar='SEED',
        help='start with a simulated robot with hidden effects, drawn by this seed',
    )
    parser.add_argument(
        '--live', action='store_true', help='show a running robot in place of a bag; needs a sourced ROS'
    )
    parser.add_argument('--host', default='127.0.0.1', help='address to listen on (%(default)s)')
    parser.add_argument(
        '--port',
        type=whole_number(0, 65535),
        default=PORT,
        help='port to listen on, 0 for any free one (%(default)s)',
    )
    parser.add_argument('--no-browser', action='store_true', help='do not open a browser')


def run(args: argparse.Namespace) -> None:
    """Serve the page until interrupted.

    Raises:
        GyrocalError: there is no bag, the model cannot be used, or the port is in use.
    """
    if args.live:
        _serve_live(args)
        return
    model, config, options = read_model(args), read_config(args), bag_options(args)
    worker = Worker()  # it forks, so it comes before any thread is started, those of Arrow included
    given = [*(args.bags or [shipped('bags')]), *_received(args.out)]
    found = named_apart([item for path in given for item in _bags(path)])
    bags = [Bag(path, config, options, name) for name, path in found]
    from gyrocal_ros.studio.server import make_app
    from gyrocal_ros.studio.workspace import Workspace  # imported while the worker starts

    workspace = Workspace(bags, model, config, args.out, worker, args.lesson)
    try:
        _serve(args, partial(make_app, workspace), f'results go to {args.out}')
    finally:
        workspace.close()


def _serve_live(args: argparse.Namespace) -> None:
    """Serve the page about a running robot until interrupted.

    Raises:
        GyrocalError: ROS is missing, or the port is in use.
    """
    if find_spec('rclpy') is None:
        raise GyrocalError('rclpy is missing', where='--live', todo='source the setup.bash of ROS 2 first')
    from gyrocal_ros.nodes.listener import listening
    from gyrocal_ros.studio.server import make_live_app

    with listening(args.namespace or '') as feed:
        _serve(args, partial(make_live_app, feed.overview), 'it shows the running robot')


def _serve(args: argparse.Namespace, make: Callable[..., Any], remark: str) -> None:
    from gyrocal_ros.studio.server import is_loopback, listen, new_token

    is_local = is_loopback(args.host)
    token = None if is_local else new_token()
    names = frozenset({args.host, 'localhost', '127.0.0.1', '[::1]'}) if is_local else None
    server = listen(make(token=token, names=names), args.host, args.port)
    name = f'[{args.host}]' if ':' in args.host else args.host
    address = f'http://{name}:{server.server_port}/{f"?token={token}" if token else ""}'
    if token is not None:
        warn(f'reachable from the network on {args.host}, without encryption: access needs the token')
    print_message(f'the studio is at {address}  (Ctrl-C ends it; {remark})')
    if not args.no_browser and sys.stderr.isatty():
        Timer(BROWSER_DELAY_S, webbrowser.open, [address]).start()
    server.serve_forever()


def named_apart(bags: list[tuple[str, Path]]) -> list[tuple[str, Path]]:
    """Return names and paths, each path once; where titles are the same, the folder before it is in the name.

    Raises:
        GyrocalError: titles are the same with the folder, too.
    """
    unique = {path.resolve(): (name or path.resolve().name, path) for name, path in bags}
    counts = Counter(name for name, _ in unique.values())
    found = [
        (f'{whole.parent.name}_{name}' if counts[name] > 1 else name, path)
        for whole, (name, path) in unique.items()
    ]
    twice = [name for name, count in Counter(name for name, _ in found).items() if count > 1]
    if twice:
        raise RecordingError(
            'is the name of several bags', where=twice[0], todo='rename one of their folders'
        )
    return found


def _received(out: Path) -> list[Path]:
    """Return the recordings that the page has received earlier."""
    from gyrocal_ros.studio.uploads import FOLDER

    return bags_in(out / FOLDER) if (out / FOLDER).is_dir() else []


def _bags(given: Path) -> list[tuple[str, Path]]:
    """Return names and paths of the recordings in what the user has given; a name may be empty."""
    if is_bag(given):
        return [('', given)]
    if (given / 'calibrations.parquet').is_file():
        return _bags_of_fleet(given)
    found = bags_in(given)
    if not found:
        raise RecordingError('contains no bag', where=str(given), todo='give a bag, or a folder of bags')
    return [('', path) for path in found]


def _bags_of_fleet(folder: Path) -> list[tuple[str, Path]]:
    """Return the bags of a fleet, those of the robot farthest from the others first."""
    require_extra()
    from gyrocal_ros.fleet.examine import bags_to_examine  # Arrow is loaded only for work on fleets

    found = bags_to_examine(folder)
    if not found:
        todo = 'copy them to where calibrations.parquet says they are, or run the fleet again'
        raise RecordingError('has no calibrated bag on this machine', where=str(folder), todo=todo)
    return found
