"""Input of YAML files."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml

from gyrocal_ros.errors import ConfigError

MAX_BYTES = 16 * 2**20
"""Largest file; those of this package have a few kilobytes."""
MAX_DEPTH = 50
"""Deepest nesting of lists and mappings."""


class YamlLoader(yaml.SafeLoader):
    """Loads `1e-3` as a number, as ROS does, where PyYAML requires `1.0e-3`; refuses a key given twice."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """Return a mapping.

        Raises:
            yaml.YAMLError: a key is given twice; the file might be read otherwise than it was meant.
        """
        mapping = super().construct_mapping(node, deep)
        if len(mapping) < len(node.value):
            keys = [self.construct_object(key, deep) for key, _ in node.value]
            twice = next(key for key in keys if keys.count(key) > 1)
            raise yaml.YAMLError(f'{twice!r} is given twice, line {node.start_mark.line + 1} on')
        return mapping


YamlLoader.add_implicit_resolver(
    'tag:yaml.org,2002:float', re.compile(r'[-+]?\d+[eE][-+]?\d+$'), list('-+0123456789')
)


def load_yaml(text: str) -> Any:
    """Read a YAML text.

    Raises:
        yaml.YAMLError: see `require_tree`.
        ValueError: a number or a date in it is impossible.
    """
    require_tree(text)
    return yaml.load(text, YamlLoader)


def require_tree(text: str) -> None:
    """Raise an error unless a YAML text is a tree that needs about as much memory as the text.

    Raises:
        yaml.YAMLError: it is not YAML, has anchors whose expansion could fill the memory, or is nested
            too deeply.
    """
    depth = 0
    for event in yaml.parse(text, YamlLoader):
        if isinstance(event, yaml.AliasEvent):
            raise yaml.YAMLError('aliases (*name) are not supported')
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > MAX_DEPTH:
            raise yaml.YAMLError(f'nested more than {MAX_DEPTH} levels deep')


def read_yaml(path: Path) -> dict[str, Any]:
    """Read a YAML file that contains a mapping.

    Raises:
        ConfigError: the file does not exist, is not YAML, or contains something else.
    """
    try:
        if path.exists() and not path.is_file():  # reading a pipe would wait for ever
            raise ConfigError('cannot be read (it is not a file)', where=str(path), todo='check the path')
        with path.open('rb') as file:
            content = file.read(MAX_BYTES + 1)
        if len(content) > MAX_BYTES:
            raise ConfigError(
                f'has more than {MAX_BYTES // 2**20} MB', where=str(path), todo='check the path'
            )
        tree = load_yaml(content.decode('utf-8'))
    except OSError as error:
        raise ConfigError(
            f'cannot be read ({error.strerror})', where=str(path), todo='check the path'
        ) from error
    except (yaml.YAMLError, ValueError) as error:
        line = ' '.join(str(error).split())
        raise ConfigError(f'is not valid YAML ({line})', where=str(path)) from error
    if not isinstance(tree, dict):
        raise ConfigError('contains no settings', where=str(path), todo='write `name: value` lines')
    return tree
