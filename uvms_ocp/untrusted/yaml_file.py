"""YAML as plain values: bounded in size, depth and number, so that no file takes long or much memory."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ValidationError
from yaml.composer import ComposerError
from yaml.events import AliasEvent
from yaml.nodes import Node, ScalarNode

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.untrusted.regular_file import read_text
from uvms_ocp.validation import one_line

_M = TypeVar("_M", bound=BaseModel)
LARGEST = 16 << 20
"""[B] of a file."""
MOST_VALUES = 500_000
"""In a file, keys included, each counted as often as anchors repeat it; a mesh of 60,000 triangles."""
DEEPEST = 32
_LONGEST_NUMBER = 100  # characters
_INTEGER = "tag:yaml.org,2002:int"


class BoundedLoader(yaml.SafeLoader):
    """Raises `yaml.YAMLError` beyond the bounds, before values are built."""

    most_values = MOST_VALUES

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._depth = 0
        self._values = 0
        self._sizes: dict[int, int] = {}
        """How many values a node with an anchor stands for."""

    def compose_node(self, parent: Node | None, index: Any) -> Node | None:
        """One value with all that is in it. Raises `ComposerError` beyond the bounds."""
        alias, event, before = self.check_event(AliasEvent), self.peek_event(), self._values
        self._require(self._depth < DEEPEST, f"deeper than {DEEPEST} levels", event)
        self._depth += 1
        node = super().compose_node(parent, index)
        self._depth -= 1
        if alias:
            self._require(id(node) in self._sizes, "a value that contains itself", event)
            self._values += self._sizes[id(node)]
        else:
            self._values += 1
            self._sizes[id(node)] = self._values - before
        self._require(self._values <= self.most_values, f"more than {self.most_values} values", event)
        if isinstance(node, ScalarNode) and node.tag == _INTEGER:
            text = f"a number of {len(node.value)} characters; at most {_LONGEST_NUMBER} are read"
            self._require(len(node.value) <= _LONGEST_NUMBER, text, event)
        return node

    @staticmethod
    def _require(kept: bool, text: str, event: Any) -> None:
        if not kept:
            raise ComposerError(None, None, text, event.start_mark)


def read_yaml(path: Path | str, loader: type[BoundedLoader] = BoundedLoader) -> object:
    """The content of a file. Raises `OSError`, or `ValueError` in one line for what is no YAML or beyond the bounds."""
    text = read_text(Path(path), LARGEST)
    try:
        return yaml.load(text, Loader=loader)
    except (yaml.YAMLError, ValueError, TypeError, OverflowError, AttributeError, LookupError) as error:
        # The constructors of PyYAML raise the latter for a date such as 2001-99-99.
        raise ValueError(" ".join(f"not valid YAML: {error}".split())[:400]) from None


def read_yaml_as(path: Path, model: type[_M]) -> _M:
    """The content of a file as a model. Raises `InvalidInput` in one line, with the file's name, for what is none."""
    try:
        return model.model_validate(read_yaml(path))
    except (OSError, ValueError) as error:
        told = one_line(error, model) if isinstance(error, ValidationError) else str(error)
        raise InvalidInput(f"{path}: {told}") from None
