"""Plays a simulated robot, or a recorded bag, as an IMU and encoder board on a pseudo-terminal.

It uses the protocol of docs/board_protocol.md, answers commands, simulates faults on request, and ends
when everything has been played or when it is interrupted. It needs no ROS.

faults:
  KIND@FROM+FOR[=SHARE]  from FROM seconds after the start, for FOR seconds
  KIND+FOR[=SHARE]       immediately: typed while it runs, one per line
"""

from __future__ import annotations

import argparse
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path

from gyrocal_ros.bag.source import open_bag
from gyrocal_ros.board.protocol import TIME_WRAP
from gyrocal_ros.cli.main import make_parser, run_program
from gyrocal_ros.cli.numbers import number, whole_number
from gyrocal_ros.cli.scenario_options import add_scenario_options, scenario_source
from gyrocal_ros.config.parameter_file import load_all
from gyrocal_ros.config.robot_sections import BoardConfig, DriverConfig
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Measurement, Span
from gyrocal_ros.emulator.board import EmulatedBoard, Oscillator, detect_sensors
from gyrocal_ros.emulator.line import FAULT_DESCRIPTIONS, EmulatedLine, parse_fault
from gyrocal_ros.emulator.schedule import Emulator
from gyrocal_ros.emulator.terminal import PseudoTerminal, RealTimePlayer
from gyrocal_ros.errors import ConfigError, GyrocalError
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.sensors import stream

PROGRAM = 'board_emulator'
EXAMPLE = """board_emulator --link /tmp/board --duration 600
board_emulator --link /tmp/board --jitter 0.02 --fault unplug@60+5 --fault noise@120+30=0.05
board_emulator --link /tmp/board --bag bags/demo"""

MAX_JITTER_S, MAX_DRIFT_PPM = 1.0, 1000.0
"""Bounds of the arguments."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument('--link', type=Path, metavar='PATH', help='symbolic link to the port')
    parser.add_argument(
        '--bag', type=Path, metavar='BAG', help='play a recording in place of a simulated robot'
    )
    add_scenario_options(parser)
    parser.add_argument('--config', type=Path, metavar='FILE', help='parameter file with the section board')
    parser.add_argument(
        '--start-at',
        type=number(0.0, unit='s'),
        metavar='S',
        help='start time in seconds since 1970 (when it is ready)',
    )
    parser.add_argument(
        '--baud-rate',
        type=whole_number(1200, 4_000_000),
        default=DriverConfig().baud_rate,
        metavar='BD',
        help='speed of the serial line (%(default)s)',
    )
    parser.add_argument(
        '--jitter',
        type=number(0.0, MAX_JITTER_S, 's'),
        default=0.0,
        metavar='S',
        help='maximum random delay of a frame (%(default)s)',
    )
    parser.add_argument(
        '--drift-ppm',
        type=number(-MAX_DRIFT_PPM, MAX_DRIFT_PPM, 'ppm'),
        default=30.0,
        metavar='PPM',
        help="rate error of the board's clock, positive if it is fast (%(default)s)",
    )
    parser.add_argument(
        '--uptime',
        type=number(0.0, unit='s'),
        metavar='S',
        help="time on the board's clock at the start (drawn by the seed)",
    )
    parser.add_argument(
        '--fault',
        action='append',
        default=[],
        metavar='KIND@FROM+FOR[=SHARE]',
        help='; '.join(f'{kind}: {about}' for kind, about in FAULT_DESCRIPTIONS.items())
        + '; may be repeated',
    )


def run(args: argparse.Namespace) -> None:
    """Play the robot.

    Raises:
        GyrocalError: an argument is out of bounds, or the bag or the link cannot be used.
    """
    config, robot = load_all(args.config)
    emulator = _emulator(args, config, robot.board)
    port = PseudoTerminal(args.link)
    signal.signal(signal.SIGTTIN, signal.SIG_IGN)  # input must not stop it in the background
    with suppress(KeyboardInterrupt), closing(port):  # an interruption is a normal end
        port.plug_in()
        print(args.link or port.name, flush=True)
        player = RealTimePlayer(emulator, port, _print_message, sys.stdin.fileno() if sys.stdin else None)
        player.play(time.time() if args.start_at is None else args.start_at)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program and return its exit status."""
    arguments = sys.argv[1:] if argv is None else list(argv)
    if '--ros-args' in arguments:  # a launch file adds them for nodes
        arguments = arguments[: arguments.index('--ros-args')]
    return run_program(
        PROGRAM, lambda: run(make_parser(PROGRAM, sys.modules[__name__]).parse_args(arguments))
    )


def _emulator(args: argparse.Namespace, config: Config, board: BoardConfig) -> Emulator:
    if not all((*board.gyro_scale_factor_volt, *board.accelerometer_scale, board.temperature_scale)):
        raise ConfigError('a scale of the board is 0', where=str(args.config))
    faults = [parse_fault(text) for text in args.fault]
    rng = stream(args.seed, PROGRAM)
    uptime_us = rng.integers(TIME_WRAP) if args.uptime is None else round(1e6 * args.uptime)
    span, measurements = _measurements(args, config)
    sensors, measurements = detect_sensors(measurements)
    if not sensors.rates.imu:
        raise GyrocalError('contains no IMU data', where=str(args.bag), todo='play another recording')
    oscillator = Oscillator(int(uptime_us), args.drift_ppm)
    line = EmulatedLine(args.baud_rate, args.jitter, faults, rng)
    return Emulator(measurements, span.start_ns, EmulatedBoard(board, sensors, oscillator), line)


def _measurements(args: argparse.Namespace, config: Config) -> tuple[Span, Iterator[Measurement]]:
    if args.bag is not None:
        recording = open_bag(args.bag, config, with_covariates=True)
        return recording.span, recording.measurements()
    robot = scenario_source(args, replace(find_scenario(args.scenario), imu_hz=DriverConfig().imu_hz))
    return robot.span, robot.board_measurements()


def _print_message(message: str) -> None:
    print(f'{PROGRAM}: {message}', file=sys.stderr, flush=True)


if __name__ == '__main__':
    sys.exit(main())
