"""Find the missing physics on a web page: see the model fail, add an effect, watch the error fall.

Give a bag, or a folder of bags to choose from; without one, those that come with the package. Nothing
else is read. What you try is kept in a folder OUT/BAG as `gyrocal improve` leaves it, so a reload or a
killed server loses nothing; give the same command again to go on.
"""

from __future__ import annotations

import argparse
import sys
import webbrowser
from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from threading import Timer
from typing import Any

from gyrocal_ros.bag.storage import bags_in, is_bag
from gyrocal_ros.cli.model_options import add_model_options, read_model
from gyrocal_ros.cli.options import add_images_option, add_topic_options, bag_options, read_config
from gyrocal_ros.cli.output import tell, warn
from gyrocal_ros.errors import GyrocalError, RecordingError
from gyrocal_ros.files import shipped
from gyrocal_ros.studio.recordings import Bag
from gyrocal_ros.studio.worker import Worker

EXAMPLE = """gyrocal studio my_bag
gyrocal studio my_bags --model model.yaml -o tried
gyrocal studio --lesson 7
gyrocal studio --live"""

PORT = 8350
SOON_S = 0.5


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument('bag', type=Path, nargs='?', metavar='BAG', help='a bag, or a folder of bags')
    add_topic_options(parser)
    add_images_option(parser)
    add_model_options(parser)
    parser.add_argument(
        '-o', '--out', type=Path, default=Path('gyrocal_studio'), help='where results go (%(default)s)'
    )
    parser.add_argument(
        '--lesson', type=int, metavar='SEED', help='begin with the riddle of that seed: find what it hides'
    )
    parser.add_argument(
        '--live', action='store_true', help='follow a running robot in place of a bag; needs a sourced ROS'
    )
    parser.add_argument('--host', default='127.0.0.1', help='address to listen on (%(default)s)')
    parser.add_argument('--port', type=int, default=PORT, help='port to listen on, 0 for any (%(default)s)')
    parser.add_argument('--no-browser', action='store_true', help='do not open a browser')


def run(args: argparse.Namespace) -> None:
    """Serve the page until interrupted.

    Raises:
        GyrocalError: there is no bag, the model cannot be used, or the port is taken.
    """
    if args.live:
        _serve_live(args)
        return
    model, config, options = read_model(args), read_config(args), bag_options(args)
    bags = [Bag(path, config, options) for path in _bags(args)]
    worker = Worker()  # before anything has made a thread
    from gyrocal_ros.studio.server import make_app
    from gyrocal_ros.studio.workspace import Workspace  # the page's libraries load while the worker begins

    desk = Workspace(bags, model, config, args.out, worker, args.lesson)
    try:
        _serve(args, partial(make_app, desk), f'results go to {args.out}')
    finally:
        desk.close()


def _serve_live(args: argparse.Namespace) -> None:
    """Follow a running robot.

    Raises:
        GyrocalError: ROS is missing, or the port is taken.
    """
    if find_spec('rclpy') is None:
        raise GyrocalError('rclpy is missing', where='--live', todo='source the setup.bash of ROS 2 first')
    from gyrocal_ros.nodes.listener import listening
    from gyrocal_ros.studio.server import make_live_app

    with listening(args.namespace or '') as feed:
        _serve(args, partial(make_live_app, feed.overview), 'it follows the robot')


def _serve(args: argparse.Namespace, make: Callable[..., Any], remark: str) -> None:
    from gyrocal_ros.studio.server import is_loopback, listen, new_token

    is_local = is_loopback(args.host)
    token = None if is_local else new_token()
    names = frozenset({args.host, 'localhost', '127.0.0.1', '[::1]'}) if is_local else None
    server = listen(make(token=token, names=names), args.host, args.port)
    name = f'[{args.host}]' if ':' in args.host else args.host
    address = f'http://{name}:{server.server_port}/{f"?token={token}" if token else ""}'
    if token is not None:
        warn(f'open to the network on {args.host}, without encryption: only who has the token gets in')
    tell(f'the studio is at {address}  (end it with Ctrl-C; {remark})')
    if not args.no_browser and sys.stderr.isatty():
        Timer(SOON_S, webbrowser.open, [address]).start()
    server.serve_forever()


def _bags(args: argparse.Namespace) -> list[Path]:
    """The recordings that may be opened."""
    if args.bag is not None and is_bag(args.bag):
        return [args.bag]
    folder = shipped('bags') if args.bag is None else args.bag
    found = bags_in(folder)
    if not found:
        raise RecordingError('holds no bag', where=str(folder), todo='give a bag, or a folder of bags')
    return found
