"""Read YAML as plain values: bounded in size, depth and number, so that no file takes long or much
memory.
"""

from __future__ import annotations

from copy import deepcopy
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ValidationError
from yaml.composer import ComposerError
from yaml.events import AliasEvent
from yaml.nodes import Node, ScalarNode

from uvms_ocp.errors import InvalidInput
from uvms_ocp.model_errors import one_line
from uvms_ocp.record.untrusted import read_text

LARGEST_YAML = 16 << 20
"""[B] largest file."""
MOST_VALUES = 500_000
"""Largest number of values of a file, enough for a mesh of 60,000 triangles. Keys count, and a value
with an anchor counts each time that an alias repeats it.
"""
DEEPEST_YAML = 32
"""Largest number of nested levels of a file."""
_LONGEST_NUMBER = 100  # characters of an integer: reading it takes the square of them
_INTEGER = "tag:yaml.org,2002:int"
# The constructors of PyYAML raise the last three for a date such as 2001-99-99.
_PARSE_ERRORS = (
    yaml.YAMLError,
    ValueError,
    TypeError,
    OverflowError,
    AttributeError,
    LookupError,
)

_Model = TypeVar("_Model", bound=BaseModel)


class BoundedLoader(yaml.SafeLoader):
    """Raises `yaml.YAMLError` beyond the bounds, before values are built."""

    most_values = MOST_VALUES
    """Values that a file may have."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._depth = 0
        self._n_values = 0
        self._sizes: dict[int, int] = {}
        """Number of values that a node with an anchor stands for, by the id of the node."""

    def compose_node(self, parent: Node | None, index: Any) -> Node | None:
        """Compose one value with all that is in it. Raises `ComposerError` beyond the bounds."""
        is_alias = self.check_event(AliasEvent)
        event = self.peek_event()
        n_before = self._n_values
        self._require(self._depth < DEEPEST_YAML, f"deeper than {DEEPEST_YAML} levels", event)
        self._depth += 1
        node = super().compose_node(parent, index)
        self._depth -= 1
        if is_alias:
            self._require(id(node) in self._sizes, "a value that contains itself", event)
            self._n_values += self._sizes[id(node)]
        else:
            self._n_values += 1
            self._sizes[id(node)] = self._n_values - n_before
        is_few = self._n_values <= self.most_values
        self._require(is_few, f"more than {self.most_values} values", event)
        if isinstance(node, ScalarNode) and node.tag == _INTEGER:
            length = len(node.value)
            text = f"a number of {length} characters; at most {_LONGEST_NUMBER} are read"
            self._require(length <= _LONGEST_NUMBER, text, event)
        return node

    @staticmethod
    def _require(is_allowed: bool, text: str, event: Any) -> None:
        if not is_allowed:
            raise ComposerError(None, None, text, event.start_mark)


def read_yaml(path: Path | str, loader: Any = BoundedLoader) -> object:
    """Read the content of a file. Raises `OSError`, or `ValueError` in one line for what is no YAML
    or beyond the bounds.
    """
    text = read_text(Path(path), LARGEST_YAML)
    try:
        return deepcopy(_parsed(text, loader))
    except _PARSE_ERRORS as error:
        raise ValueError(" ".join(f"not valid YAML: {error}".split())[:400]) from None


# Parsed values by text and loader. `read_yaml` copies them, as callers may change what they get.
_parsed = lru_cache(maxsize=4)(yaml.load)


def read_yaml_as(path: Path, model: type[_Model]) -> _Model:
    """Read the content of a file as a model of pydantic. Raises `InvalidInput` in one line, with the
    file's name, where it is no YAML or does not fit the model.
    """
    try:
        return model.model_validate(read_yaml(path))
    except (OSError, ValueError) as error:
        if isinstance(error, ValidationError):
            text = one_line(error, model)
        else:
            text = str(error)
        raise InvalidInput(f"{path}: {text}") from None
