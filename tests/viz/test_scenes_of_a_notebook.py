"""Scenes of a notebook: the viewer comes once, scenes beside it are data, and what is in sight is
drawn.
"""

from __future__ import annotations

import base64
import html
import re
import sys
from collections.abc import Callable, Iterator
from io import BytesIO
from types import ModuleType, SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import matplotlib.image as mpl_image
import numpy as np
import pytest
from scene_picture import at

from uvms_ocp.record.record import Record
from uvms_ocp.robot.robot import Robot
from uvms_ocp.viz import show
from uvms_ocp.viz.scene import page as pages
from uvms_ocp.viz.scene.page import ScenePage
from uvms_ocp.viz.scene.page_server import served

VIEWER = "class Viewer{"
IDE = (  # the policy of a page of outputs in VS Code
    "default-src 'none'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; style-src 'self'"
    " 'unsafe-inline' https: http: data:; img-src 'self' https: http: data:; font-src https: http:"
    " data:; connect-src https: http: data:; child-src https: data:"
)
Run = Callable[..., str]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch) -> Run:
    """Shows pages as a cell of a notebook does, by the kernel's message for that cell: its
    outputs.
    """
    messages = iter(range(1000))

    def run(cell: str, *shown: ScenePage, named: bool = True) -> str:
        metadata = {"cellId": cell} if named else {}
        parent = {
            "header": {"msg_id": str(next(messages))},
            "metadata": metadata,
            "content": {"code": cell},
        }
        shell = SimpleNamespace(kernel=SimpleNamespace(get_parent=lambda: parent))
        monkeypatch.setattr("IPython.get_ipython", lambda: shell)
        return "".join(page._repr_html_() for page in shown)

    pytest.importorskip("IPython")
    monkeypatch.setattr(pages, "_shown", {})
    return run


@pytest.fixture(scope="module")
def page(robot: Robot) -> ScenePage:
    return show(robot, height=300)


def _viewers(*outputs: str) -> list[int]:
    return [output.count(VIEWER) for output in outputs]


@pytest.mark.parametrize("named", [True, False])
def test_the_viewer_comes_with_the_first_scene_alone(
    run: Run, page: ScenePage, named: bool
) -> None:
    outputs = [
        run("a", page, page, named=named),
        run("b", page, named=named),
        run("c", page, named=named),
    ]
    assert _viewers(*outputs) == [1, 0, 0]
    assert len(outputs[1]) < 200_000 < 800_000 < len(outputs[0])


def test_a_cell_that_is_run_again_brings_it_again(run: Run, page: ScenePage) -> None:
    """It may be the one that brought it, or stand where that one was cleared."""
    assert _viewers(
        run("a", page), run("b", page), run("a", page), run("c", page), run("b", page, page)
    ) == [1, 0, 1, 0, 1]


def test_where_each_cell_is_a_page_of_its_own_each_scene_is_whole(
    run: Run, page: ScenePage, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "google.colab", ModuleType("google.colab"))
    assert _viewers(run("a", page, page), run("b", page)) == [2, 1]


def test_without_a_notebook_each_scene_is_whole(page: ScenePage) -> None:
    assert _viewers(page._repr_html_(), page._repr_html_()) == [1, 1]


def test_what_is_shown_out_of_any_cell_is_drawn_too(
    run: Run, page: ScenePage, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the callback of a slider, or before any message."""
    before = [run("a", page)]
    for parent in ({"header": {"msg_id": "m"}, "metadata": {}, "content": {"comm_id": "c"}}, {}):
        shell = SimpleNamespace(kernel=SimpleNamespace(get_parent=lambda parent=parent: parent))
        monkeypatch.setattr("IPython.get_ipython", lambda shell=shell: shell)
        assert page.html.partition("<title>")[0] in html.unescape(page._repr_html_())
    monkeypatch.setattr("IPython.get_ipython", lambda: SimpleNamespace(kernel=object()))
    assert _viewers(*before, page._repr_html_()) == [1, 1], (
        "an old kernel, of which nothing is known"
    )


def test_where_frames_are_taken_out_a_picture_and_a_sentence_are_left(
    run: Run, page: ScenePage, robot: Robot
) -> None:
    for output in (run("a", page), run("b", page)):
        visible_text = re.sub(r"<script>.*?</script>|<[^>]*>", "", output, flags=re.DOTALL)
        assert visible_text.startswith("A scene is drawn here by scripts")
        (picture,) = re.findall(r'<img [^>]*src="data:image/svg\+xml;base64,([^"]*)"/>', output)
        path = ElementTree.fromstring(base64.b64decode(picture))[0].attrib["d"]
        assert path.count("M") == robot.n_joints


def _document(*outputs: str, policy: str = "") -> ScenePage:
    """As an exported notebook is: a page of outputs."""
    head = '<link rel="icon" href="data:,">'
    if policy:
        head += f'<meta http-equiv="Content-Security-Policy" content="{html.escape(policy)}">'
    cells = "".join(f"<div>{output}</div>" for output in outputs)
    return ScenePage(html=f"<!DOCTYPE html><html><head>{head}</head><body>{cells}</body></html>")


def _opened(chromium: Any, document: ScenePage) -> Iterator[Any]:
    with served(document) as address:
        sheet = chromium.new_page(viewport={"width": 900, "height": 700})
        sheet.wrong = list[str]()
        sheet.on("pageerror", lambda error: sheet.wrong.append(str(error)))
        sheet.on(
            "console",
            lambda message: sheet.wrong.append(message.text) if message.type == "error" else None,
        )
        sheet.goto(address)
        yield sheet
        sheet.close()


def _picture(sheet: Any, k: int) -> np.ndarray:
    """The picture of the scene at that place, which is scrolled to; it has been drawn."""
    frame = sheet.locator("iframe").nth(k)
    frame.scroll_into_view_if_needed()
    content = frame.element_handle().content_frame()  # the same where the page in it is replaced
    content.wait_for_function(
        "typeof renderer === 'object' && !renderer.getContext().isContextLost() &&"
        " renderer.info.render.triangles > 0",
        timeout=10_000,
    )
    sheet.wait_for_timeout(300)
    picture: np.ndarray = mpl_image.imread(BytesIO(frame.screenshot()))[..., :3]
    return picture


@pytest.mark.slow
@pytest.mark.parametrize("policy", ["", IDE])
@pytest.mark.parametrize("first", [0, 2])
def test_scenes_that_are_data_look_as_the_one_that_is_whole(
    chromium: Any, run: Run, page: ScenePage, first: int, policy: str
) -> None:
    """Wherever on the page that one stands."""
    outputs = [run("a", page), run("b", page), run("c", page)]
    outputs.insert(first, outputs.pop(0))
    for sheet in _opened(chromium, _document(*outputs, policy=policy)):
        pictures = [_picture(sheet, k) for k in range(3)]
        assert np.std(pictures[first], axis=(0, 1)).min() > 0.02, "not empty"
        for picture in pictures:
            np.testing.assert_allclose(picture, pictures[first], atol=0.02)
        assert sheet.wrong == []


@pytest.mark.slow
def test_a_page_that_has_lost_the_viewer_says_what_to_do_and_draws_once_it_comes(
    chromium: Any, run: Run, page: ScenePage
) -> None:
    whole = run("a", page)
    data = run("b", page)
    for sheet in _opened(chromium, _document(data)):
        sheet.frame_locator("iframe").get_by_text("Run this cell again").wait_for(timeout=20_000)
        sheet.evaluate(
            "(output) => {"
            " document.body.append(document.createRange().createContextualFragment(output)); }",
            whole,
        )
        assert np.std(_picture(sheet, 0), axis=(0, 1)).min() > 0.02
        sheet.evaluate("document.querySelectorAll('iframe')[1].remove()")
        sheet.evaluate(
            "(output) => {"
            " document.body.append(document.createRange().createContextualFragment(output)); }",
            run("c", page),
        )
        assert np.std(_picture(sheet, 1), axis=(0, 1)).min() > 0.02, "the page remembers the viewer"


@pytest.mark.slow
def test_of_more_scenes_than_a_page_has_contexts_for_each_is_drawn_where_it_is_seen(
    chromium: Any, run: Run, page: ScenePage
) -> None:
    for sheet in _opened(chromium, _document(*(run(str(k), page) for k in range(20)))):
        pictures = [_picture(sheet, k)[:, :500] for k in (0, 10, 19, 0)]  # beside the panels
        for picture in pictures:
            assert np.std(picture, axis=(0, 1)).min() > 0.02
            np.testing.assert_allclose(picture, pictures[0], atol=0.02)


@pytest.mark.slow
def test_a_context_that_was_lost_comes_back_with_all_that_it_drew(
    chromium: Any, record: Record, robot: Robot
) -> None:
    lose = "renderer.getContext().getExtension('WEBGL_lose_context').loseContext()"
    with served(show(record, robot)) as address:
        sheet = chromium.new_page(viewport={"width": 640, "height": 400})
        sheet.goto(f"{address}#t=0")
        before = at(sheet, 3.0)
        sheet.evaluate(
            "renderer.domElement.addEventListener('webglcontextrestored', () => { window.again ="
            " true; })"
        )
        sheet.evaluate(lose)
        for _ in range(100):
            if sheet.evaluate("window.again"):
                break
            sheet.wait_for_timeout(100)
        sheet.wait_for_timeout(500)
        np.testing.assert_allclose(at(sheet, 3.0), before, atol=0.02)
        sheet.close()
