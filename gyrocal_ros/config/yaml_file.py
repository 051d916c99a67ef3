"""Input of YAML files."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml

from gyrocal_ros.errors import ConfigError


class YamlLoader(yaml.SafeLoader):
    """Loads `1e-3` as a number, as ROS does; PyYAML requires `1.0e-3`."""


YamlLoader.add_implicit_resolver(
    'tag:yaml.org,2002:float', re.compile(r'[-+]?\d+[eE][-+]?\d+$'), list('-+0123456789')
)


def read_yaml(path: Path) -> dict[str, Any]:
    """Read a YAML file that contains a mapping.

    Raises:
        ConfigError: the file does not exist, is not YAML, or contains something else.
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
        raise ConfigError('contains no settings', where=str(path), todo='write `name: value` lines')
    return tree
