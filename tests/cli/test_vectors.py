"""Three numbers may be written with commas, and may be negative."""

from __future__ import annotations

import pytest

from uvms_ocp.cli.commands import app, expand_vectors


@pytest.mark.parametrize("given", ["--position -3,1,2", "--position=-3,1,2", "--position -3 1 2"])
def test_a_vector_is_three_numbers_however_it_is_written(given: str) -> None:
    words = f"plan curve {given} --sphere -1,2,3,0.1 --out a,b,c".split()
    expanded = [
        "plan",
        "curve",
        "--position",
        "-3",
        "1",
        "2",
        "--sphere",
        "-1,2,3,0.1",
        "--out",
        "a,b,c",
    ]
    assert expand_vectors(app, words) == expanded


def test_words_that_are_no_vectors_stay_as_they_are() -> None:
    words = ["run", "reach", "--fault", "joint:stuck=1,2,3@8", "--seed=5"]
    assert expand_vectors(app, words) == words
