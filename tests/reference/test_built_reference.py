"""The reference builds, whole, without a broken link and for no network."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from links import broken_links

from uvms_ocp.errors import NameNotFound, OutputError
from uvms_ocp.reference import build
from uvms_ocp.reference.build import body_of, build_reference

pytestmark = pytest.mark.slow

EQUATION = re.compile(r"\$\$.+?\$\$", re.DOTALL)

pytest.importorskip("pdoc", reason='needs pip install "uvms-ocp[reference]"')


def outside_links(folder: Path) -> Iterator[str]:
    """Scripts, styles and pictures that a page would load from a network."""
    for path in folder.rglob("*.html"):
        text = path.read_text(encoding="utf-8")
        yield from (
            f"{path.name}: {word}" for word in ("@import", 'src="http', "src='http") if word in text
        )


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_reference(tmp_path_factory.mktemp("built") / "reference").parent


def test_it_is_whole_and_loads_nothing_from_a_network(reference: Path) -> None:
    assert broken_links(reference) == ()
    assert list(outside_links(reference)) == []
    first = (reference / "index.html").read_text(encoding="utf-8")
    for name in (
        "motion.html",
        "robot_files.html",
        "series.html",
        "commands.html",
        "uvms_ocp/tasks.html",
    ):
        assert f'href="{name}"' in first


def test_the_search_of_every_page_has_all_pages_and_all_names_of_the_code(reference: Path) -> None:
    text = (reference / "pages.js").read_text(encoding="utf-8")
    pages = json.loads(text.removeprefix("window.pages = ").removesuffix(";\n"))
    assert {address for address, _, _ in pages} | {"index.html"} == {
        path.name for path in reference.glob("*.html")
    } - {"uvms_ocp.html"}
    assert any(
        address == "statuses.html" and "horizon too short" in body for address, _, body in pages
    )
    assert "window.pdocSearch" in (reference / "search.js").read_text(encoding="utf-8")
    for path in (reference / address for address, _, _ in pages):
        assert all(
            word in path.read_text(encoding="utf-8")
            for word in ('src="pages.js"', '"search.js"', 'id="find"')
        )


def test_formulas_are_drawn_by_the_browser_itself(reference: Path) -> None:
    page = (reference / "tasks.html").read_text(encoding="utf-8")
    assert page.count('<math xmlns="http://www.w3.org/1998/Math/MathML" display="block">') > 10
    assert "$" not in re.sub(r"<(script|style).*?</\1>", "", page, flags=re.DOTALL)


def test_arguments_are_shown_by_what_they_allow(reference: Path) -> None:
    inside = (
        "object at 0x",
        "PydanticUndefined",
    )  # of the interpreter, and of what checks settings
    pages = {page.name: page.read_text(encoding="utf-8") for page in reference.rglob("*.html")}
    assert [name for name, text in pages.items() if any(word in text for word in inside)] == []


def test_a_name_that_is_not_there_is_refused() -> None:
    with pytest.raises(NameNotFound, match=r"PoseTsk.*PoseTask"):
        body_of("`uvms_ocp.tasks.pose.PoseTsk`", ("uvms_ocp.tasks.pose",))


def test_a_folder_that_cannot_be_one_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(build, "documented_modules", lambda pages: ("uvms_ocp.version",))
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="choose another folder"):
        build_reference(tmp_path / "file")
