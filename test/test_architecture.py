"""Architecture tests: who imports whom, how long a module is, which module holds each equation."""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

from gyrocal_ros.effects import COVARIATE_EFFECTS, EFFECTS

PROJECT = Path(__file__).resolve().parent.parent
PACKAGE = PROJECT / 'gyrocal_ros'
MODULES = sorted(PACKAGE.rglob('*.py'))

BANDS = {
    'base': ('config', 'data', 'errors', 'files', 'kernels', 'workers'),
    'core': ('effects', 'ekf', 'model', 'statistics'),
    'io': ('bag', 'board', 'msgs', 'vision'),
    'lab': ('bench', 'diagnose', 'emulator', 'fleet', 'pipeline', 'report', 'sim'),
    'robot': ('robot',),
    'edge': ('cli', 'nodes', 'studio'),
}
"""Rooms by band, the lowest first. A room imports from its own band and the bands below."""
BAND_OF = {room: level for level, rooms in enumerate(BANDS.values()) for room in rooms}

FORBIDDEN = {
    'robot': {'bag', 'bench', 'diagnose', 'emulator', 'fleet', 'report', 'sim'},
    'diagnose': {'sim', 'report', 'bench', 'fleet'},
    'fleet': {'sim', 'report', 'bench'},
    'report': {'sim', 'bench'},
}
"""Imports that the bands allow and the data flow does not: the robot needs no bag and no simulator."""

EVERYWHERE = {'numpy', 'yaml'} | sys.stdlib_module_names
ROS = {
    *('rclpy', 'rcl_interfaces', 'rosgraph_msgs', 'rosidl_runtime_py', 'std_msgs', 'std_srvs', 'tf2_msgs'),
    *('ament_index_python', 'launch', 'launch_ros'),
    *('diagnostic_msgs', 'geometry_msgs', 'nav_msgs', 'sensor_msgs', 'visualization_msgs'),
}
FORKS = dict.fromkeys(('bench/faults/isolated.py', 'workers.py'), {'os._exit'})
"""Modules with a process of their own, which may end it."""
LIBRARY_HOMES = {
    'argcomplete': ('cli/completion.py',),
    'cv2': ('vision', 'model/camera.py', 'sim/canvas.py', 'sim/render.py', 'msgs/images.py'),
    **dict.fromkeys(('dash', 'flask', 'werkzeug'), ('studio',)),
    'kaleido': ('report/png.py',),
    'lz4': ('bag/decompress.py',),
    'plotly': (
        'report/plot.py',
        'report/png.py',
        'report/calibration_figures.py',
        'report/comparison_figures.py',
        'report/diagnosis_figures.py',
        'report/fleet_figures.py',
        'report/paper.py',
    ),
    **dict.fromkeys(('dask', 'distributed', 'fsspec', 'pyarrow'), ('fleet',)),
    **dict.fromkeys(ROS, ('nodes',)),
    'rosbags': ('bag', 'msgs'),
    'scipy': (
        'statistics.py',
        'fleet/comparison.py',
        'fleet/hierarchy.py',
        'bench/batch.py',
        'bench/bag_tracks.py',
    ),
    'serial': ('board/link.py',),
    'tqdm': ('cli/output.py',),
}
"""The one room of each outside library, so that it can be exchanged or go missing without harm elsewhere."""

EFFECTS_APART = {
    *(
        '__init__',
        'base',
        'checks',
        'describe',
        'fading',
        'library',
        'model_file',
        'quantities',
        'registry',
        'sketch',
        'traits',
    )
}
"""Modules of the room of effects that hold no effect."""
ROOMS_WITHOUT_EFFECTS = ('bench', 'diagnose', 'sim')
EFFECT_MAKERS = {
    'scale.scale_power',
    'scale.FULL_RATE_RAD_S',
    'covariate.covariate_bank',
    'covariate.covariate_bias',
    'covariate.covariate_effects',
    'covariate.covariate_scale',
}
"""Functions, and the constant of one, by which rooms without effects make those that have a parameter."""

MAX_LINES, NODE_LINES = 400, 150
EQUATIONS_OF_THE_PAPER = range(1, 23)


def room(module: Path) -> str:
    """Room of a module file: `ekf` of `gyrocal_ros/ekf/slam.py`, `data` of `gyrocal_ros/data.py`."""
    return module.relative_to(PACKAGE).parts[0].removesuffix('.py')


def part(module: Path) -> str:
    """Part of a room: `features` of `gyrocal_ros/ekf/features/robust.py`, `slam` of `ekf/slam.py`."""
    return module.relative_to(PACKAGE).parts[1].removesuffix('.py')


def imported_modules(module: Path) -> set[str]:
    """Full dotted names of all that a module imports, inside functions too."""
    names = set()
    for node in ast.walk(ast.parse(module.read_text(encoding='utf-8'))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f'{module}:{node.lineno}: imports are absolute here'
            names |= {f'{node.module}.{alias.name}' for alias in node.names}
    return names


def docstrings(module: Path) -> list[str]:
    """Docstrings of a module and of every class and function in it."""
    tree = ast.parse(module.read_text(encoding='utf-8'))
    kinds = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    return [ast.get_docstring(node) or '' for node in ast.walk(tree) if isinstance(node, kinds)]


def code_of(module: Path) -> str:
    """Return the code of a module without comments and strings."""
    tree = ast.parse(module.read_text(encoding='utf-8'))
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            node.value = ''
    return ast.unparse(tree)


def equations_at_home(docstring: str) -> set[int]:
    """Numbers of the equations that a docstring says it is: a capital `Eq. (13)`, `Eqs. (16), (17)`.

    In `eq. (13)` another place is meant.
    """
    numbers = set()
    for group in re.findall(r'\bEqs?\. (\(\d+\)(?:(?:, | and |-)\(\d+\))*)', docstring):
        for first, last in re.findall(r'\((\d+)\)(?:-\((\d+)\))?', group):
            numbers |= set(range(int(first), int(last or first) + 1))
    return numbers


def rooms_imported(module: Path) -> set[str]:
    """Other rooms that a module imports from."""
    names = (name for name in imported_modules(module) if name.startswith('gyrocal_ros.'))
    return {name.split('.')[1] for name in names} - {'__version__', room(module)}


@pytest.mark.slow
def test_each_room_imports_from_its_band_and_below() -> None:
    assert not imported_modules(PACKAGE / '__init__.py'), 'the package itself imports nothing'
    modules = [module for module in MODULES if module.parent != PACKAGE or module.stem != '__init__']
    assert {room(module) for module in modules} <= BAND_OF.keys(), 'a new room needs its band'
    wrong = [
        f'{module.relative_to(PACKAGE)} imports {other}'
        for module in modules
        for other in rooms_imported(module)
        if BAND_OF[other] > BAND_OF[room(module)] or other in FORBIDDEN.get(room(module), ())
    ]
    assert wrong == []


@pytest.mark.slow
def test_no_rooms_import_each_other_in_a_circle() -> None:
    graph: dict[str, set[str]] = {}
    for module in MODULES:
        graph.setdefault(room(module), set()).update(rooms_imported(module))
    assert list(TopologicalSorter(graph).static_order()), 'raises CycleError where there is a circle'


@pytest.mark.slow
@pytest.mark.parametrize('divided', sorted({path.parts[-3] for path in PACKAGE.glob('*/*/__init__.py')}))
def test_no_parts_of_a_room_import_each_other_in_a_circle(divided: str) -> None:
    """Parts are the folders of a room, and its modules beside them."""
    graph: dict[str, set[str]] = {}
    for module in MODULES:
        if room(module) == divided:
            names = imported_modules(module)
            graph.setdefault(part(module), set()).update(
                name.split('.')[2] for name in names if name.startswith(f'gyrocal_ros.{divided}.')
            )
    assert len(graph) > 1
    circles = {name: others - {name} for name, others in graph.items()}
    assert list(TopologicalSorter(circles).static_order()), 'raises CycleError where there is a circle'


@pytest.mark.slow
def test_outside_libraries_stay_in_their_room() -> None:
    wrong = []
    for module in MODULES:
        place = module.relative_to(PACKAGE).as_posix()
        libraries = {name.split('.')[0] for name in imported_modules(module)} - {'gyrocal_ros'}
        for library in libraries - EVERYWHERE:
            homes = LIBRARY_HOMES.get(library, ())
            if not any(place == home or place.startswith(f'{home}/') for home in homes):
                wrong.append(f'{place} imports {library}')
    assert wrong == []


def test_the_report_computes_nothing() -> None:
    """Linear algebra belongs to `diagnose`; a compute process of the studio needs no report."""
    algebra = re.compile(r'linalg|lstsq|einsum|pinv|covariance|np\.(?:dot|cov|outer)\b|(?<=\w) @ (?=\w)')
    wrong = [
        f'{module.relative_to(PACKAGE)}: {found[0]}'
        for module in MODULES
        if room(module) == 'report' and (found := algebra.search(code_of(module)))
    ]
    assert wrong == []
    for name in ('worker', 'executor', 'tasks'):
        assert 'report' not in rooms_imported(PACKAGE / 'studio' / f'{name}.py')


@pytest.mark.slow
def test_modules_are_short_and_only_the_edge_prints() -> None:
    wrong = []
    for module in MODULES:
        text = module.read_text(encoding='utf-8')
        if len(text.splitlines()) > (NODE_LINES if room(module) == 'nodes' else MAX_LINES):
            wrong.append(f'{module.relative_to(PACKAGE)} is too long')
        calls = {ast.unparse(node.func) for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Call)}
        if room(module) not in ('cli', 'nodes') and calls & {
            'print',
            'exit',
            'quit',
            'input',
            'sys.exit',
            'os._exit',
        } - FORKS.get(module.relative_to(PACKAGE).as_posix(), set()):
            wrong.append(f'{module.relative_to(PACKAGE)} prints or exits')
    assert wrong == []


@pytest.mark.slow
def test_each_equation_of_the_paper_has_one_home() -> None:
    homes: dict[int, set[str]] = {number: set() for number in EQUATIONS_OF_THE_PAPER}
    for module in MODULES:
        for docstring in docstrings(module):
            for number in equations_at_home(docstring):
                homes[number].add(f'{module.relative_to(PACKAGE).as_posix()}: {docstring.splitlines()[0]}')
    assert {number: places for number, places in homes.items() if len(places) != 1} == {}


def test_equation_numbers_are_read_from_docstrings() -> None:
    assert equations_at_home('Eq. (13): a point in the camera frame.') == {13}
    assert equations_at_home('Eqs. (16), (17): the first sight, without eq. (18).') == {16, 17}
    assert equations_at_home('Eq. (10): the robot; Eqs. (1)-(3) and (5): the rest.') == {1, 2, 3, 5, 10}


def test_every_effect_is_in_the_table_of_contents() -> None:
    modules = {module.stem for module in (PACKAGE / 'effects').glob('*.py')}
    contents = imported_modules(PACKAGE / 'effects' / 'library.py')
    listed = {name.split('.')[2] for name in contents if name.startswith('gyrocal_ros.effects.')}
    assert listed <= modules
    assert modules - listed | {'base'} == EFFECTS_APART


def effect_names_in(module: Path) -> Iterator[str]:
    """Names of effects that a module mentions: as a string, or as its beginning before `:` or `.`."""
    for node in ast.walk(ast.parse(module.read_text(encoding='utf-8'))):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            name = re.split('[:.]', node.value, maxsplit=1)[0]
            if name in EFFECTS or name in COVARIATE_EFFECTS:
                yield name


def effects_imported_by(module: Path) -> Iterator[str]:
    """What a module imports from modules of effects, but for what any effect may be made with."""
    for name in imported_modules(module):
        room_name, effect, made = [*name.split('.'), '', '', ''][1:4]
        is_module = room_name == 'effects' and (PACKAGE / 'effects' / f'{effect}.py').is_file()
        if is_module and effect not in EFFECTS_APART and f'{effect}.{made}' not in EFFECT_MAKERS:
            yield name


@pytest.mark.parametrize('name', ROOMS_WITHOUT_EFFECTS)
def test_the_room_knows_no_effect_by_name(name: str) -> None:
    """An effect of the user's is then treated as one of the library."""
    modules = sorted((PACKAGE / name).rglob('*.py'))
    assert modules
    found = {
        module.relative_to(PACKAGE).as_posix(): [*effect_names_in(module), *effects_imported_by(module)]
        for module in modules
    }
    assert {place: names for place, names in found.items() if names} == {}


def test_names_and_imports_of_effects_are_found(tmp_path: Path) -> None:
    module = tmp_path / 'module.py'
    module.write_text(
        'from gyrocal_ros.effects import EFFECTS\n'
        'from gyrocal_ros.effects.base import column\n'
        'from gyrocal_ros.effects.scale import scale_power\n'
        'from gyrocal_ros.effects.gyro_lag import GyroLag\n'
        'import gyrocal_ros.effects.turn_slip\n'
        "names = ['wheel_scale', 'the wheel_scale', f'covariate_bias:{1}', 'cross_axis.mx', 'scale']\n"
    )
    assert sorted(effect_names_in(module)) == ['covariate_bias', 'cross_axis', 'wheel_scale']
    assert sorted(effects_imported_by(module)) == [
        'gyrocal_ros.effects.gyro_lag.GyroLag',
        'gyrocal_ros.effects.turn_slip',
    ]


@pytest.mark.slow
def test_no_text_knows_the_machine_it_was_written_on() -> None:
    folders = '|'.join(['work', 'root', 'home', 'Users'])
    machine_path = re.compile(rf'(?<![\w.~}}])/(?:{folders})/\w')
    kinds = {'.py', '.md', '.rst', '.toml', '.cfg', '.xml', '.yaml', '.txt', ''}
    for file in PROJECT.rglob('*'):
        inside = file.relative_to(PROJECT)
        hidden = any(part.startswith('.') and part not in ('.ci', '.gitignore') for part in inside.parts)
        generated = inside.parts[0] in ('build', 'install', 'log', 'gyrocal_demo')  # as in .gitignore
        if file.is_file() and file.suffix in kinds and not hidden and not generated:
            found = machine_path.search(file.read_text(encoding='utf-8'))
            assert found is None, f'{inside}: {found and found[0]}'
