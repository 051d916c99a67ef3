"""The plan of the house, kept by machine: who imports whom, how long a module is, where a formula lives."""

from __future__ import annotations

import ast
import re
import sys
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parent.parent
PACKAGE = PROJECT / 'gyrocal_ros'
MODULES = sorted(PACKAGE.rglob('*.py'))

LEVELS = {
    room: level
    for level, rooms in enumerate(
        [
            ('errors',),
            ('settings',),
            ('config', 'data', 'files'),
            ('config_file', 'model'),  # the lens and the rotations of the paper serve the tracker too
            ('board', 'recording', 'vision'),
            ('effects', 'ekf', 'sim'),
            ('seeing',),
            ('calibrate', 'calibration', 'diagnose'),
            ('bench', 'live', 'report'),
            ('nodes', 'studio'),
            ('cli',),
        ]
    )
    for room in rooms
}
"""A room imports only from rooms of a lower level, and from itself."""

EVERYWHERE = {'numpy', 'yaml'} | sys.stdlib_module_names
ROS = {
    *('rclpy', 'rcl_interfaces', 'rosgraph_msgs', 'rosidl_runtime_py', 'std_msgs', 'std_srvs', 'tf2_msgs'),
    *('ament_index_python', 'launch', 'launch_ros'),
    *('diagnostic_msgs', 'geometry_msgs', 'nav_msgs', 'sensor_msgs', 'visualization_msgs'),
}
LIBRARY_HOMES = {
    'cv2': ('vision', 'model/camera.py', 'sim/render.py', 'recording/images.py'),
    **dict.fromkeys(('dash', 'flask', 'werkzeug'), ('studio',)),
    'kaleido': ('report/figures/png.py',),
    'plotly': ('report/figures',),
    **dict.fromkeys(ROS, ('nodes',)),
    'rosbags': ('recording',),
    'scipy': ('bench/batch.py',),
    'serial': ('board/link.py',),
    'tqdm': ('cli/output.py',),
}
"""The one room of each outside library, so that it can be exchanged or go missing without harm elsewhere."""

MAX_LINES = 400
EQUATIONS_OF_THE_PAPER = range(1, 23)


def room(module: Path) -> str:
    """Room of a module file: `ekf` of `gyrocal_ros/ekf/slam.py`, `data` of `gyrocal_ros/data.py`."""
    return module.relative_to(PACKAGE).parts[0].removesuffix('.py')


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


def equations_at_home(docstring: str) -> set[int]:
    """Numbers of the equations that a docstring says it is: a capital `Eq. (13)`, `Eqs. (16), (17)`.

    In `eq. (13)` another place is meant.
    """
    numbers = set()
    for group in re.findall(r'\bEqs?\. (\(\d+\)(?:(?:, | and |-)\(\d+\))*)', docstring):
        for first, last in re.findall(r'\((\d+)\)(?:-\((\d+)\))?', group):
            numbers |= set(range(int(first), int(last or first) + 1))
    return numbers


@pytest.mark.parametrize('module', MODULES, ids=lambda module: module.relative_to(PACKAGE).as_posix())
class TestEachModule:
    def test_imports_only_downwards(self, module: Path) -> None:
        if module == PACKAGE / '__init__.py':
            assert not imported_modules(module), 'the package itself imports nothing'
            return
        own = room(module)
        others = {
            name.split('.')[1]
            for name in imported_modules(module)
            if name.startswith('gyrocal_ros.') and name != 'gyrocal_ros.__version__'
        } - {own}
        assert others <= LEVELS.keys(), 'a new room needs its level'
        assert {other for other in others if LEVELS[other] >= LEVELS[own]} == set()

    def test_outside_libraries_stay_in_their_room(self, module: Path) -> None:
        place = module.relative_to(PACKAGE).as_posix()
        libraries = {name.split('.')[0] for name in imported_modules(module)} - {'gyrocal_ros'}
        for library in libraries - EVERYWHERE:
            homes = LIBRARY_HOMES.get(library, ())
            assert any(place == home or place.startswith(f'{home}/') for home in homes), library

    def test_only_the_edge_prints_and_exits(self, module: Path) -> None:
        calls = {
            ast.unparse(node.func)
            for node in ast.walk(ast.parse(module.read_text(encoding='utf-8')))
            if isinstance(node, ast.Call)
        }
        if room(module) not in ('cli', 'nodes'):
            assert not calls & {'print', 'exit', 'quit', 'input', 'sys.exit', 'os._exit'}

    def test_is_short(self, module: Path) -> None:
        assert len(module.read_text(encoding='utf-8').splitlines()) <= MAX_LINES


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


def test_every_effect_stands_in_the_table_of_contents() -> None:
    modules = {module.stem for module in (PACKAGE / 'effects').glob('*.py')}
    contents = imported_modules(PACKAGE / 'effects' / '__init__.py')
    listed = {name.split('.')[2] for name in contents if name.startswith('gyrocal_ros.effects.')}
    assert modules - listed == {'__init__', 'model_file', 'sketch', 'words'}


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
