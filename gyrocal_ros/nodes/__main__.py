"""Run a node by name: `python -m gyrocal_ros.nodes calibrator --ros-args ...`."""

import sys

from gyrocal_ros.nodes.main import NODES, run

if __name__ == '__main__':
    if len(sys.argv) < 2 or sys.argv[1] not in NODES:
        print(f'usage: python -m gyrocal_ros.nodes {"|".join(NODES)} [--ros-args ...]', file=sys.stderr)
        sys.exit(2)
    sys.exit(run(sys.argv[1], sys.argv[2:]))
