"""YAML files."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml

from gyrocal_ros.errors import ConfigError


class YamlLoader(yaml.SafeLoader):
    """Takes `1e-3` for a number, as ROS does; PyYAML insists on `1.0e-3`."""


YamlLoader.add_implicit_resolver(
    'tag:yaml.org,2002:float', re.compile(r'[-+]?\d+[eE][-+]?\d+$'), list('-+0123456789')
)


def read_yaml(path: Path) -> dict[str, Any]:
    """Read a YAML file that holds a mapping.

    Raises:
        ConfigError: there is no such file, or it is not YAML, or holds something else.
    """
    try:
        tree = yaml.load(path.read_text(encoding='utf-8'), YamlLoader)
    except OSError as error:
        raise ConfigError(
            f'cannot be read ({error.strerror})', where=str(path), todo='check the path'
        ) from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        line = str(error).replace('\n', ' ')
        raise ConfigError(f'is not valid YAML ({line})', where=str(path)) from error
    if not isinstance(tree, dict):
        raise ConfigError('holds no settings', where=str(path), todo='write `name: value` lines')
    return tree
