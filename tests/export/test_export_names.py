"""The name of an export is an identifier of C, by default one like that of the mission."""

from __future__ import annotations

from pathlib import Path

import pytest

from uvms_ocp.errors import InvalidInput
from uvms_ocp.export import export_controller
from uvms_ocp.export.names import export_name, functions_in, structures_in, with_prefix
from uvms_ocp.scenario.cases import case1

REFUSED = "give an identifier of C: letters, digits and _, a letter first, 63 at most, no keyword$"


@pytest.mark.parametrize(
    "name", ["", "2fast", "a-b", "a b", "_mine", "naïve", "a\n", "double", "x" * 64, "../up", "a/b"]
)
def test_what_is_no_identifier_is_refused_before_anything_is_done(
    name: str, tmp_path: Path
) -> None:
    with pytest.raises(InvalidInput, match=REFUSED) as caught:
        export_controller(case1(duration=0.1), tmp_path / "c", name)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "c").exists()


@pytest.mark.parametrize("name", ["a", "Left_2", "x" * 63, "controller", "NAME"])
def test_an_identifier_is_taken_as_it_is(name: str) -> None:
    assert export_name(name, "mission") == name


@pytest.mark.parametrize(
    ("mission", "name"),
    [
        ("case1", "case1"),
        ("my mission-2", "my_mission_2"),
        ("2 rounds", "m_2_rounds"),
        ("_hidden_", "hidden"),
        ("Fahrt über Grund", "Fahrt_ber_Grund"),
        ("深", "mission"),
        ("", "mission"),
        ("switch", "switch_"),
        ("x" * 100, "x" * 63),
    ],
)
def test_the_name_of_a_mission_becomes_an_identifier(mission: str, name: str) -> None:
    assert export_name(None, mission) == name
    assert export_name(name, "") == name


def test_a_prefix_stands_before_identifiers_but_not_before_fields_and_texts() -> None:
    code = 'int levels(int w);\nm->levels.call = levels; "levels"; levels_work; a.levels; x_levels'
    assert with_prefix(code, "p_", {"levels"}) == (
        'int p_levels(int w);\nm->levels.call = p_levels; "levels"; levels_work; a.levels; x_levels'
    )


def test_what_other_files_can_see_is_found() -> None:
    code = """static double hidden(int n) { return inner(n); }
EXPORT const casadi_int *seen(int i) {
  return called(i);
}
static inline int small(int x);
int plain(const double **arg,
          int mem);
typedef struct {
  double x;
} Part;
"""
    assert functions_in(code) == {"seen", "plain"}
    assert structures_in(code) == {"Part"}
