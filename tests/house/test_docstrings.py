"""Every public function says what it raises."""

from __future__ import annotations

import package_ast as house
import pytest


@pytest.mark.slow
def test_every_public_function_that_can_raise_says_what() -> None:
    wrong = []
    for place in house.public_functions():
        text = house.documentation(place)
        errors = [name for name in house.raised(place) if name[:1].isupper() and name != "Exit"]
        silent = sorted(name for name in errors if name not in text)
        if silent:
            wrong.append(f"{place.name}: {', '.join(silent)}")
    assert not wrong, f"{len(wrong)} functions\n" + "\n".join(wrong)
