"""Installs the package: with colcon as an ament_python package, with pip on a machine without ROS."""

from collections import defaultdict
from pathlib import Path

from setuptools import Extension, find_packages, setup

try:
    import numpy
    from Cython.Build import cythonize
except ImportError:  # the NumPy forms are used
    cythonize = None

NAME = 'gyrocal_ros'
SHARE = Path('share') / NAME
# Bokeh draws the dashboard of Dask; from 26 on pyarrow needs NumPy 2, and ROS 2 Jazzy has 1.26.
FLEET = ['bokeh>=3.1', 'dask>=2024.1', 'distributed>=2024.1', 'fsspec>=2023.10', 'pyarrow>=14.0,<26']
PNG = ['kaleido>=1.0']  # draws figures by a Chromium that is there
TEST = ['pytest>=7.4,<9', 'pytest-xdist>=3.7']  # the plugin of launch_testing in Jazzy fails with pytest 9


def data_files(*folders: str) -> list[tuple[str, list[str]]]:
    """Pair every folder below `folders` with its files, for installation under share/."""
    placed: dict[str, list[str]] = defaultdict(list)
    for file in sorted(file for folder in folders for file in Path(folder).rglob('*') if file.is_file()):
        placed[str(SHARE / file.parent)].append(str(file))
    return list(placed.items())


def kernels() -> list[Extension]:
    """Return the compiled twins of NumPy functions; without a compiler they are left out."""
    if cythonize is None:
        return []
    files = sorted(Path(NAME, 'kernels').glob('*.pyx'))
    settings = {
        'include_dirs': [numpy.get_include()],
        'define_macros': [('NPY_NO_DEPRECATED_API', 'NPY_1_7_API_VERSION')],
        'extra_compile_args': ['-O3', '-g0'],
    }
    twins = [
        Extension(f'{NAME}.kernels.{file.stem}', [str(file)], **settings, optional=True) for file in files
    ]
    # What Cython writes depends on the declarations that come with NumPy. colcon reads what is printed.
    return cythonize(twins, build_dir=f'build/numpy-{numpy.__version__}', quiet=True)


setup(
    name=NAME,
    version='0.1.0',
    description='Calibrates the gyro of an indoor robot while it works, and finds what its model lacks',
    long_description=Path('README.md').read_text(encoding='utf-8'),
    long_description_content_type='text/markdown',
    license='Apache-2.0',
    keywords='gyroscope calibration imu ros2 slam system-identification',
    classifiers=[
        'Development Status :: 4 - Beta',
        'Environment :: Console',
        'Environment :: Web Environment',
        'Intended Audience :: Developers',
        'Intended Audience :: Manufacturing',
        'Intended Audience :: Science/Research',
        'Operating System :: POSIX :: Linux',
        'Programming Language :: Python :: 3',
        'Programming Language :: Python :: 3.11',
        'Programming Language :: Python :: 3.12',
        'Programming Language :: Python :: 3.13',
        'Topic :: Scientific/Engineering',
        'Typing :: Typed',
    ],
    author='gyrocal_ros maintainers',
    python_requires='>=3.11',
    ext_modules=kernels(),
    packages=find_packages(include=[NAME, f'{NAME}.*']),
    package_data={
        NAME: [
            'py.typed',
            'bench/kept.json',
            'diagnose/separability.json',
            'kernels/*.pxd',
            'kernels/*.pyx',
            'studio/assets/*',
        ]
    },
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (str(SHARE), ['package.xml']),
        *data_files('bags', 'config', 'launch'),
    ],
    # Ranges, not pins: newer OpenCV wheels insist on numpy 2, older ones work with the 1.26 of ROS 2 Jazzy.
    install_requires=[
        'argcomplete>=3.0',
        'dash>=4.0',
        'numpy>=1.26',
        'opencv-python-headless>=4.9',
        'plotly>=5.20',
        'pyserial>=3.5',
        'pyyaml>=6.0',
        'rosbags>=0.11.6',
        'scipy>=1.11',
        'tqdm>=4.60',
    ],
    extras_require={
        'fleet': FLEET,
        'test': TEST,
        'png': PNG,
        'docs': ['mkdocs>=1.6,<2', 'mkdocs-material>=9.5,<10', 'mkdocstrings[python]>=0.26'],
        'dev': [
            *FLEET,
            *TEST,
            *PNG,
            'mypy>=1.10',
            'axe-playwright-python>=0.1.4',
            'playwright>=1.40',
            'ruff>=0.8',
            'types-PyYAML',
            'types-tqdm',
        ],
    },
    entry_points={
        'console_scripts': [
            'gyrocal = gyrocal_ros.cli.main:main',
            'board_emulator = gyrocal_ros.cli.board_emulator:main',
            'driver = gyrocal_ros.nodes.main:driver',
            'calibrator = gyrocal_ros.nodes.main:calibrator',
            'tracker = gyrocal_ros.nodes.main:tracker',
            'player = gyrocal_ros.nodes.main:player',
            'ceiling_emulator = gyrocal_ros.nodes.main:ceiling_emulator',
        ]
    },
    options={'build_ext': {'parallel': True}},  # one compiler per core
    zip_safe=False,
)
