"""From ``hydrodynamics.yaml`` to a checked `RobotDescription`; a variant replaces some of its keys."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError

from uvms_ocp.exceptions import RobotDataError
from uvms_ocp.model.files.description import RobotDescription
from uvms_ocp.untrusted.yaml_file import BoundedLoader, read_yaml
from uvms_ocp.validation import one_line


def read_description(path: Path, variant: Path | None = None) -> RobotDescription:
    """Read and validate one YAML file; every mistake is a one-line ``RobotDataError``.

    The keys of ``variant``, a file of the same schema with some of its keys, replace those of the first file.
    """
    content = _read_mapping(path)
    if variant is not None:
        content = _overlaid(content, _read_mapping(variant))
    try:
        return RobotDescription.model_validate(content)
    except ValidationError as error:
        raise RobotDataError(variant or path, one_line(error, RobotDescription)) from None


def _read_mapping(path: Path) -> dict[str, Any]:
    content = _read_yaml(path)
    if not isinstance(content, dict):
        raise RobotDataError(path, "the file must hold keys and values; it is empty or a bare value")
    return content


def _overlaid(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    merged = dict(below)
    for key, value in above.items():
        nested = isinstance(value, dict) and isinstance(below.get(key), dict)
        merged[key] = _overlaid(below[key], value) if nested else value
    return merged


def _read_yaml(path: Path) -> object:
    try:
        return read_yaml(path, _RobotFile)
    except OSError as error:
        raise RobotDataError(path, f"cannot be read ({error.strerror or error})") from None
    except ValueError as error:
        raise RobotDataError(path, str(error)) from None


class _RobotFile(BoundedLoader):
    """PyYAML silently keeps the last of two equal keys; a robot file must not hide a value."""

    most_values = 50_000  # a robot of a hundred links has some 5,000


def _mapping_with_unique_keys(loader: _RobotFile, node: yaml.MappingNode) -> dict[Any, Any]:
    keys = [loader.construct_object(key, deep=True) for key, _ in node.value]
    mapping = loader.construct_mapping(node, deep=True)  # refuses keys that cannot be counted
    repeated = sorted(str(key) for key, n in Counter(keys).items() if n > 1)
    if repeated:
        raise yaml.constructor.ConstructorError(None, None, f"repeated key {repeated[:3]}", node.start_mark)
    return mapping


def _word(loader: _RobotFile, node: yaml.ScalarNode) -> str:
    """Read yes, no, true, ... as words: nothing in the file is true or false, and true must not pass as 1.0."""
    return str(loader.construct_scalar(node))


_RobotFile.add_constructor("tag:yaml.org,2002:bool", _word)
_RobotFile.add_constructor(yaml.resolver.BaseResolver.DEFAULT_MAPPING_TAG, _mapping_with_unique_keys)
