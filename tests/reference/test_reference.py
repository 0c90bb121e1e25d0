"""The reference builds without a warning, its links lead somewhere, and nothing public is left
without a word.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from links import broken_links
from undocumented import undocumented_names

import uvms_ocp
from uvms_ocp.campaign.jobs import ERROR, KILLED, TIME_LIMIT
from uvms_ocp.errors import AdvisedStatus
from uvms_ocp.identification.channel_mapping import ChannelMapping
from uvms_ocp.identification.recording import CHANNEL_KINDS
from uvms_ocp.identification.settings import CalibrationSettings, NoiseSettings, QuantitySettings
from uvms_ocp.record.tables import SERIES
from uvms_ocp.reference import build
from uvms_ocp.reference.build import guide_pages, theory_pages
from uvms_ocp.reference.cited_names import CITED, documented_modules, place_of
from uvms_ocp.reference.generated_pages import generated_pages
from uvms_ocp.report.end_of_run import ENDS

EQUATION = re.compile(r"\$\$.+?\$\$", re.DOTALL)


def test_every_public_name_is_documented() -> None:
    pages = (*guide_pages().values(), *theory_pages().values())
    assert list(undocumented_names(documented_modules("\n".join(pages)))) == []


def test_names_are_loaded_when_asked_for_after_the_reference_was_built_too() -> None:
    documented_modules("")
    assert uvms_ocp.scenarios is uvms_ocp.scenario  # by its name of earlier versions


@pytest.mark.parametrize("name", build.ORDER)
def test_every_equation_says_which_code_states_it(name: str) -> None:
    text = theory_pages()[name]
    parts = EQUATION.split(text)
    assert len(parts) > 1, "a page of theory has equations"
    for part in parts[1:]:
        assert part.startswith("\n\nCode: `uvms_ocp."), part[:60]
    for cited in CITED.findall(text):
        place_of(cited)


def test_pages_that_are_written_by_hand_are_all_in_their_order() -> None:
    place = Path(build.__file__)
    assert {path.stem for path in place.with_name("theory").iterdir()} == {
        *build.ORDER,
        "first_page",
    }
    assert {path.stem for path in place.with_name("guide").iterdir()} == set(build.GUIDE)


def test_no_page_is_written_over_another_and_links_between_them_name_one() -> None:
    pages = [*guide_pages().items(), *theory_pages().items(), *generated_pages().items()]
    names = [name for name, _ in pages]
    assert len(names) == len(set(names))
    linked = {link for _, text in pages for link in re.findall(r"\((\w+)\.md\)", text)}
    assert linked
    assert linked <= set(names)


def test_every_end_of_a_mission_and_of_a_run_of_a_campaign_stands_with_what_to_do() -> None:
    table = guide_pages()["faults"].partition("## When a sensor")[0]
    rows = re.findall(r"^\| `([^`]+)` \| (.+) \| (.+) \|$", table, re.MULTILINE)
    assert [name for name, _, _ in rows] == [*ENDS, ERROR, KILLED, TIME_LIMIT]
    assert all(meaning.strip() and cure.strip() for _, meaning, cure in rows)
    assert "(faults.md)" in generated_pages()["statuses"]


def test_every_status_stands_with_what_to_do() -> None:
    page = generated_pages()["statuses"]
    assert {"Status", "OcpStatus", "PlanStatus", "FitStatus"} <= {
        kind.__name__ for kind in AdvisedStatus.__subclasses__()
    }
    for kind in AdvisedStatus.__subclasses__():
        assert f"`{kind.__module__}.{kind.__name__}`" in page
        for member in kind:
            assert (
                f"| `{member.value}` | {' '.join(member.advice.replace('|', chr(92) + '|').split())} |"
                in page
            )


def test_tables_hold_every_series_every_field_and_every_command() -> None:
    pages = generated_pages()
    assert all(f"`{name}`" in pages["series"] for name in SERIES)
    assert all(
        f"## uvms-ocp {name}\n" in pages["commands"]
        for name in ("run", "show", "plan mission", "export controller")
    )
    assert all(
        f"| `{name}` |" in pages["channels"]
        for name in (*CHANNEL_KINDS, *ChannelMapping.model_fields)
    )
    assert "`--ghost PATH`" in pages["commands"]
    assert "[Thruster](#thruster)" in pages["robot_files"]
    known_names = (
        *CalibrationSettings.model_fields,
        *QuantitySettings.model_fields,
        *NoiseSettings.model_fields,
        "quadratic_drag",
        "wrench_offset",
    )
    assert all(f"| `{name}` |" in pages["identification_settings"] for name in known_names)


def test_links_that_lead_nowhere_are_found(tmp_path: Path) -> None:
    (tmp_path / "a.html").write_text(
        '<p id="here"></p><a href="#here"></a><a href="b.html#there"></a><a href="c.html"></a>'
    )
    (tmp_path / "b.html").write_text('<a href="a.html#here"></a><a href="https://example.org"></a>')
    assert broken_links(tmp_path) == ("a.html: b.html#there", "a.html: c.html")
