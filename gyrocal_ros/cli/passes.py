"""Several runs of the filter over one bag, for the commands that compare models."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

from gyrocal_ros.calibrate import Progress, calibrate, hold
from gyrocal_ros.cli.options import bag_options, read_config
from gyrocal_ros.cli.output import progress, warn
from gyrocal_ros.config import Config
from gyrocal_ros.data import Source
from gyrocal_ros.ekf.run import Run
from gyrocal_ros.model.sensor import Effect, SensorModel
from gyrocal_ros.recording.bag import open_bag
from gyrocal_ros.recording.check import check_bag
from gyrocal_ros.recording.findings import one_a_kind, refuse_errors


@dataclass(frozen=True, slots=True)
class Passes:
    """A bag, held for several runs."""

    source: Source
    config: Config

    def calibrate(self, model: SensorModel, candidates: tuple[Effect, ...] = ()) -> Run:
        """Run the filter once.

        Raises:
            GyrocalError: it cannot be done with this bag or this model.
        """
        with _bar(f'run with {model.effects[-1].name}', self.source) as report:
            return calibrate(self.source, self.config, model, report=report, candidates=candidates)


def open_passes(args: argparse.Namespace, model: SensorModel) -> Passes:
    """Check the bag that the arguments name, read it, and follow its images.

    Raises:
        GyrocalError: it cannot be calibrated from.
    """
    config, options = read_config(args), bag_options(args)
    if args.from_images:
        config = replace(config, recording=replace(config.recording, use_images=True))
    findings = check_bag(args.bag, config, **options).findings
    refuse_errors(findings, str(args.bag))
    for finding in one_a_kind(findings):
        warn(str(finding))
    source = open_bag(args.bag, config, with_covariates=True, **options)
    with _bar('reading', source) as report:
        return Passes(*hold(source, config, model, report))


@contextmanager
def _bar(label: str, source: Source) -> Iterator[Callable[[Progress], None]]:
    with progress(label, total=round(source.span.duration_s), unit='s') as bar:
        yield lambda state: bar.update(round(state.done_s) - bar.n)
