"""No YAML file takes long, and what is beyond the bounds is said in one line."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from uvms_ocp.errors import InvalidInput
from uvms_ocp.record.yaml_file import BoundedLoader, read_yaml
from uvms_ocp.robot.description import read_description
from uvms_ocp.robot.shapes.obstacles import read_obstacles

READERS: tuple[Callable[[Path], object], ...] = (read_description, read_obstacles)
_NINE = ", ".join(["*b{0}"] * 9)
BEYOND = {
    "lists in lists": ("[" * 3000 + "]" * 3000, "deeper than 32 levels"),
    "mappings in mappings": (
        "".join(f"{' ' * i}a:\n" for i in range(500)),
        "deeper than 32 levels",
    ),
    "lists in blocks": ("- " * 500 + "a", "deeper than 32 levels"),
    "a long whole number": (
        f"water_density: {'9' * 5000}",
        "a number of 5000 characters; at most 100 are read",
    ),
    "a long number to another base": (
        f"water_density: 0x{'f' * 5000}",
        "a number of 5002 characters",
    ),
    "a value in itself": ("a: &a [*a]", "a value that contains itself"),
    "laughter": (
        "b0: &b0 [1]\n" + "".join(f"b{i}: &b{i} [{_NINE.format(i - 1)}]\n" for i in range(1, 10)),
        "more than 50",
    ),
    "a date that is none": ("a: 2001-99-99", "month must be in 1..12"),
    "an object": ("a: !!python/object/apply:os.mkdir [trap]", "could not determine a constructor"),
    "bytes that are none": ("a: !!binary 'a'", "not valid YAML"),
    "a key that is a list": ("? [a]\n: 1", "found unhashable key"),
    "no text": ("\udcff", "no text in UTF-8"),
    "a device's message": ("a: \x07", "not valid YAML"),
}


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("case", BEYOND)
def test_what_is_beyond_the_bounds_is_said_in_one_line(
    case: str, reader: Callable[[Path], object], tmp_path: Path
) -> None:
    text, message = BEYOND[case]
    path = tmp_path / "a.yaml"
    path.write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(InvalidInput, match=message) as caught:
        reader(path)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 600


@pytest.mark.slow
@pytest.mark.parametrize("reader", READERS)
def test_twenty_thousand_unknown_keys_are_told_by_the_first_few(
    reader: Callable[[Path], object], tmp_path: Path
) -> None:
    path = tmp_path / "a.yaml"
    path.write_text("obstacles: []\n" + "".join(f"k{i}: {i}\n" for i in range(20_000)))
    with pytest.raises(InvalidInput, match="k0") as caught:
        reader(path)
    assert len(str(caught.value)) < 1500


def test_effort_grows_with_the_number_of_mistakes_and_not_with_its_square(tmp_path: Path) -> None:
    """Counted in calls of the loader, not timed: one per key and one per value."""
    calls = []

    class Counting(BoundedLoader):
        most_values = 10_000

        def compose_node(self, parent: object, index: object) -> object:  # type: ignore[override]
            calls.append(index)
            return super().compose_node(parent, index)  # type: ignore[arg-type]

    (tmp_path / "a.yaml").write_text("".join(f"k{i}: {i}\n" for i in range(100_000)))
    with pytest.raises(ValueError, match="more than 10000 values"):
        read_yaml(tmp_path / "a.yaml", Counting)
    assert len(calls) < 10_100


def test_anchors_count_as_often_as_they_are_used(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text("a: &a {x: 1, y: 2}\nb: *a\nc: [*a, *a]")
    assert read_yaml(path) == {
        "a": {"x": 1, "y": 2},
        "b": {"x": 1, "y": 2},
        "c": [{"x": 1, "y": 2}] * 2,
    }

    class Few(BoundedLoader):
        most_values = 20

    with pytest.raises(ValueError, match="more than 20 values"):
        read_yaml(path, Few)


@pytest.mark.parametrize("key", ["a[b]", "[", "a.b", "a\nb", "\u202e", "k" * 900, ""])
def test_an_unknown_key_may_be_called_anything(key: str, tmp_path: Path) -> None:
    for content in ({key: 1}, {"links": {"base_link": {key: 1}}}):
        (tmp_path / "a.yaml").write_text(json.dumps(content))
        with pytest.raises(InvalidInput, match="unknown key; known here: ") as caught:
            read_description(tmp_path / "a.yaml")
        assert str(caught.value).isprintable()
        assert len(str(caught.value)) < 900
