"""Every number that a user meets says its unit, every array its shape, and every function what it raises."""

from __future__ import annotations

import ast
import re

import package_ast as house

UNIT = re.compile(r"\[[^\[\]]+\]")
SHAPE = re.compile(r"\((?:[\w.*+\- ]+,? ?)*\)")
SENTENCE = re.compile(r"(?:\.\s|;|\n\n|$)")


def _told(text: str, name: str) -> list[str]:
    """From each mention of a name to the end of its sentence."""
    found = []
    for match in re.finditer(rf"(?<![\w.]){re.escape(name)}(?!\w)", text):
        end = SENTENCE.search(text, match.end())
        found.append(text[match.start() : end.start() if end else len(text)])
    return found


def test_every_field_that_is_a_number_carries_its_unit_and_every_array_its_shape() -> None:
    wrong = []
    for place, field, text in house.fields():
        annotation = ast.unparse(field.annotation)
        if field.target.id.startswith("_") or "ClassVar" in annotation or not house.NUMBERS.search(annotation):
            continue
        if not UNIT.search(text) or (house.ARRAYS.search(annotation) and not SHAPE.search(text)):
            wrong.append(f"{place.name}.{field.target.id}: {text!r}")
    assert not wrong, f"{len(wrong)} fields\n" + "\n".join(wrong)


def test_every_parameter_that_is_a_number_carries_its_unit_and_every_array_its_shape() -> None:
    wrong = []
    for place in house.public_functions():
        text = house.documentation(place)
        for name, annotation in house.parameters(place.node):
            if not house.NUMBERS.search(annotation) or name.startswith("_") or _speaks_for_itself(annotation):
                continue
            told = _told(text, name)
            if not any(UNIT.search(part) for part in told):
                wrong.append(f"{place.name}({name}: {annotation}): no unit")
            elif house.ARRAYS.search(annotation) and not any(SHAPE.search(part) for part in told):
                wrong.append(f"{place.name}({name}: {annotation}): no shape")
    assert not wrong, f"{len(wrong)} parameters\n" + "\n".join(wrong)


def test_every_public_function_that_can_raise_says_what() -> None:
    wrong = []
    for place in house.public_functions():
        text = house.documentation(place)
        silent = sorted(
            name for name in house.raised(place) if name[:1].isupper() and name != "Exit" and name not in text
        )
        if silent:
            wrong.append(f"{place.name}: {', '.join(silent)}")
    assert not wrong, f"{len(wrong)} functions\n" + "\n".join(wrong)


def _speaks_for_itself(annotation: str) -> bool:
    """Functions document their own parameters; options of commands carry their unit in the help text."""
    return "Callable" in annotation or "Annotated" in annotation
