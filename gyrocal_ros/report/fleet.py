"""The page of a fleet: one file with figures, and tables to sort and filter."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from html import escape
from typing import Any

import numpy as np

from gyrocal_ros import __version__
from gyrocal_ros.diagnose.status import Level, Status
from gyrocal_ros.fleet.findings import Findings, advice
from gyrocal_ros.fleet.result import FAILED
from gyrocal_ros.report.describe import Verdict
from gyrocal_ros.report.fleet_figures import fleet_sections
from gyrocal_ros.report.html import document, gallery, table, verdict_box

BAG_COLUMNS = (
    'robot',
    'bag',
    'time',
    'status',
    'scale_factor',
    'scale_factor_std',
    'bias',
    'converged',
    'verdict',
    'effect',
    'reason',
)
"""Columns of the table of bags."""
ROBOT_COLUMNS = ('robot', 'bags', 'scale_factor', 'scale_factor_std', 'bias', 'largest_z', 'out_of_family')


def fleet_page(found: Findings, tolerance: float) -> str:
    """Return the page as HTML.

    Args:
        found: the findings.
        tolerance: relative tolerance of the scale factor by the data sheet.
    """
    good = int(found.table.calibrated.sum())
    about = f'{len(found.robots)} robots, {len(found.table)} bags, {good} calibrated; gyrocal {__version__}'
    parts = [
        verdict_box(_verdict(found)),
        _coefficients(found),
        _effects(found),
        gallery(fleet_sections(found, tolerance), 'Figures'),
        _interactive(found),
    ]
    return document('Fleet', about, parts)


def _verdict(found: Findings) -> Verdict:
    faulty, missing = list(found.out_of_family), [item.effect for item in found.pooled.found]
    sentences = []
    if faulty:
        shown = ', '.join(faulty[:10]) + (f' and {len(faulty) - 10} more' if len(faulty) > 10 else '')
        sentences.append(f'Out of family: {shown}.')
    failed_bags = found.table.columns['status'].count(FAILED)
    if failed_bags:
        plural = 's' if failed_bags > 1 else ''
        sentences.append(f'{failed_bags} bag{plural} could not be used; the table of bags has the reasons.')
    if missing:
        headline = f'All robots lack {" and ".join(missing)}'
    elif faulty:
        headline = f'{len(faulty)} of {len(found.robots)} robots are out of family'
    else:
        headline = 'No effect is missing in the fleet, and no robot is out of family'
    level: Level = 'yellow' if missing or faulty else 'green'
    return Verdict(Status(level, headline), tuple(sentences), tuple(advice(found)))


def _coefficients(found: Findings) -> str:
    rows = [
        (
            name,
            f'{item.mean.value:.6g} ± {item.mean.std:.2g}',
            f'{item.spread.value:.3g} ({item.spread.low:.2g} to {item.spread.high:.2g})',
            f'{item.bag_spread:.2g}',
            '; '.join(
                f'{slope.value:+.2g} ({slope.low:+.2g} to {slope.high:+.2g}) per {regressor}'
                for regressor, slope in item.slopes.items()
            )
            or '-',
            found.units[name],
        )
        for name, item in (found.coefficients | found.effects).items()
    ]
    heads = ('coefficient', 'fleet mean', 'part-to-part spread (95 %)', 'bag to bag', 'drift (95 %)', 'unit')
    note = 'At 25 °C and zero age. Robots out of family do not count.'
    return table('Coefficients', heads, rows, note) if rows else ''


def _effects(found: Findings) -> str:
    rows = [
        (
            item.effect,
            ', '.join(
                f'{name} = {value:.3g} ± {std:.2g} {unit}'
                for name, value, std, unit in zip(
                    item.names, item.values.tolist(), item.stds.tolist(), item.units, strict=True
                )
            ),
            f'{item.sigma:.1f}',
            f'{item.per_bag_sigma:.1f}',
            ', '.join(item.confused_with) or '-',
            'all robots',
        )
        for item in found.pooled.found
    ]
    rows += [
        (
            item.effect,
            f'{item.name} = {item.value:.3g} {item.unit}',
            f'{item.sigma:.1f}',
            '-',
            ', '.join(item.also) or '-',
            item.robot,
        )
        for item in found.robot_effects
    ]
    heads = ('effect', 'coefficients', 'sigma', 'sigma in one bag', 'not distinguishable from', 'robots')
    return table('Missing effects', heads, rows) if rows else ''


def _interactive(found: Findings) -> str:
    """Return the tables of robots and bags; a script draws the rows that are in view."""
    data = {
        'robots': {'columns': ROBOT_COLUMNS, 'rows': list(_robots(found))},
        'bags': {'columns': BAG_COLUMNS, 'rows': list(_bags(found))},
    }
    text = json.dumps(data, separators=(',', ':'), allow_nan=False).replace('<', '\\u003c')
    return (
        _table_frame('robots', 'Robots', 'Select a robot to list its bags.')
        + _table_frame('bags', 'Bags', 'Click a column to sort by it.')
        + f'<script type="application/json" id="fleet-data">{text}</script><script>{SCRIPT}</script>'
    )


def _table_frame(name: str, title: str, note: str) -> str:
    return (
        f'<h2>{escape(title)}</h2><p class="note">{escape(note)} '
        f'<input id="{name}-filter" type="search" placeholder="filter" aria-label="filter {name}"> '
        f'<span id="{name}-count"></span></p>'
        f'<div id="{name}-view" style="max-height:26rem;overflow:auto"><table style="width:100%">'
        f'<thead style="position:sticky;top:0;background:var(--paper)"><tr id="{name}-head"></tr></thead>'
        f'<tbody id="{name}-rows"></tbody></table></div>'
    )


def _robots(found: Findings) -> Iterator[list[Any]]:
    scale, bias = found.coefficients.get('scale_factor'), found.coefficients.get('bias')
    count = dict.fromkeys(found.robots, 0)
    for robot in found.table.columns['robot']:
        count[str(robot)] += 1
    outside = found.out_of_family
    for index, robot in enumerate(found.robots):
        z = [item.robot_z[index] for item in found.coefficients.values() if index < len(item.robot_z)]
        values = [
            scale.robot_value[index] if scale and index < len(scale.robot_value) else math.nan,
            scale.robot_std[index] if scale and index < len(scale.robot_std) else math.nan,
            bias.robot_value[index] if bias and index < len(bias.robot_value) else math.nan,
            max(np.abs(z), default=math.nan),
        ]
        yield [robot, count[robot], *map(_rounded, values), ', '.join(outside.get(robot, ())) or None]


def _bags(found: Findings) -> Iterator[list[Any]]:
    columns = found.table.columns
    for row in range(len(found.table)):
        yield [_rounded(columns[name][row]) for name in BAG_COLUMNS]


def _rounded(value: Any) -> Any:
    if isinstance(value, float | np.floating):
        return float(f'{value:.7g}') if math.isfinite(value) else None
    return value


SCRIPT = """
(() => {
  const data = JSON.parse(document.getElementById('fleet-data').textContent), high = 34, tables = {};
  const get = id => document.getElementById(id);
  function make(name, select) {
    const {columns, rows} = data[name], view = get(name + '-view'), body = get(name + '-rows');
    let shown = rows, by = -1, up = true;
    const text = rows.map(row => row.join(' ').toLowerCase());
    const index = new Map(rows.map((row, i) => [row, i]));
    columns.forEach((column, i) => {
      const head = document.createElement('th');
      head.textContent = column; head.tabIndex = 0; head.style.cursor = 'pointer';
      head.onclick = () => { up = by === i ? !up : true; by = i; update(); };
      head.onkeydown = event => { if (event.key === 'Enter') head.onclick(); };
      get(name + '-head').append(head);
    });
    const order = (a, b) => a === b ? 0 : a === null ? 1 : b === null ? -1 : (a < b ? -1 : 1) * (up ? 1 : -1);
    function draw() {
      const first = Math.max(0, Math.floor(view.scrollTop / high) - 10);
      const last = Math.min(shown.length, first + 45);
      const pad = count => { const row = document.createElement('tr'); row.style.height = count * high + 'px';
        return row; };
      const lines = shown.slice(first, last).map(row => {
        const line = document.createElement('tr'); line.style.height = high + 'px';
        row.forEach(value => { const cell = document.createElement('td'); cell.textContent = value ?? '-';
          line.append(cell); });
        if (select) { line.style.cursor = 'pointer'; line.tabIndex = 0; line.onclick = () => select(row);
          line.onkeydown = event => { if (event.key === 'Enter') select(row); }; }
        return line;
      });
      body.replaceChildren(pad(first), ...lines, pad(shown.length - last));
    }
    function update() {
      const words = get(name + '-filter').value.toLowerCase().split(' ').filter(word => word);
      shown = rows.filter(row => words.every(word => text[index.get(row)].includes(word)));
      if (by >= 0) shown = [...shown].sort((a, b) => order(a[by], b[by]));
      get(name + '-count').textContent = shown.length + ' of ' + rows.length;
      view.scrollTop = 0; draw();
    }
    view.onscroll = draw; get(name + '-filter').oninput = update; update();
  }
  make('bags');
  make('robots', row => { const filter = get('bags-filter'); filter.value = row[0];
    filter.oninput(); filter.scrollIntoView(); });
})();
"""
