"""Notebooks in JupyterLab, in a browser: a cell is interrupted, then all run; scene and tables are
there, tracebacks are not.
"""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from compiler import long_without_compiler

from uvms_ocp.viz.scene.pictures import browser, missing

pytestmark = [pytest.mark.slow, long_without_compiler]
if missing():
    pytest.skip(missing(), allow_module_level=True)
if find_spec("jupyterlab") is None:
    pytest.skip(
        'jupyterlab is not installed; run: pip install "uvms-ocp[notebooks]"',
        allow_module_level=True,
    )

NOTEBOOKS = Path(__file__).parents[1] / "notebooks"
TOKEN = "of-this-test"
PATIENCE = 900.0  # [s] for what compiles on a busy machine
ALL_CELLS = {"windowingMode": "none"}  # also those that nobody scrolls to
READY = """(path) => {
  const {context, sessionContext} = window.jupyterapp?.shell.currentWidget ?? {};
  const isReady = context?.path === path && context.isReady && sessionContext.isReady;
  return isReady && sessionContext.session?.kernel?.status === 'idle';
}"""
MODEL = "() => window.jupyterapp.shell.currentWidget.content.model.toJSON()"
BUSY = (
    "() => window.jupyterapp.shell.currentWidget.content.widgets.map((cell) => (cell.prompt ||"
    " '').trim())"
)


SCENES = (
    (
        "import uvms_ocp as uo; from uvms_ocp.viz import live, show; robot ="
        " uo.load_robot('girona_maris7'); show(robot, height=250)"
    ),
    "show(robot, height=250)",
    "view = live(robot, height=250); view",
    "print(view.q[0])",
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("work")


def _write_notebook(path: Path, cells: list[dict[str, Any]]) -> None:
    kernel = {"kernelspec": {"name": "python3", "display_name": "Python 3", "language": "python"}}
    path.write_text(
        json.dumps({"cells": cells, "metadata": kernel, "nbformat": 4, "nbformat_minor": 5})
    )


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory, folder: Path) -> Iterator[str]:
    """The address of a server in an empty folder, for notebooks that are copied there."""
    home = tmp_path_factory.mktemp("home")
    empty = {"cell_type": "code", "metadata": {}, "outputs": [], "execution_count": None}
    _write_notebook(
        folder / "scenes.ipynb",
        [empty | {"id": f"c{k}", "source": source} for k, source in enumerate(SCENES)],
    )
    for name in ("01_first_mission", "05_lexicographic_ocp"):
        shutil.copy(NOTEBOOKS / f"{name}.ipynb", folder)
    settings = (
        home / "settings" / "@jupyterlab" / "notebook-extension" / "tracker.jupyterlab-settings"
    )
    settings.parent.mkdir(parents=True)
    settings.write_text(json.dumps(ALL_CELLS))
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    folders = {
        "JUPYTER_CONFIG_DIR": home / "config",
        "JUPYTER_DATA_DIR": home / "data",
        "JUPYTER_RUNTIME_DIR": home / "runtime",
    }
    options = [
        f"--port={port}",
        "--no-browser",
        "--allow-root",
        f"--IdentityProvider.token={TOKEN}",
        f"--notebook-dir={folder}",
    ]
    options += [
        f"--LabApp.user_settings_dir={home / 'settings'}",
        "--LabApp.expose_app_in_browser=True",
    ]
    log = (home / "log").open("w")
    command = [sys.executable, "-m", "jupyterlab", *options]
    server = subprocess.Popen(
        command,
        env=os.environ | {key: str(path) for key, path in folders.items()},
        stdout=log,
        stderr=log,
    )
    address = f"http://127.0.0.1:{port}"
    try:
        _until(lambda: _answers(f"{address}/api?token={TOKEN}"), lambda: (home / "log").read_text())
        yield address
    finally:
        server.terminate()
        server.wait(30.0)
        log.close()


def _answers(address: str) -> bool:
    try:
        with urllib.request.urlopen(address, timeout=5.0) as answer:
            return bool(answer.status == 200)
    except OSError:
        return False


def _until(true: Callable[[], bool], tell: Callable[[], object]) -> None:
    end = time.monotonic() + PATIENCE
    while not true():
        assert time.monotonic() < end, tell()
        time.sleep(0.2)


class Notebook:
    """An open notebook."""

    def __init__(self, page: Any, address: str, name: str) -> None:
        self.page = page
        page.goto(
            f"{address}/lab/tree/{name}.ipynb?reset&token={TOKEN}"
        )  # without notebooks that were open before
        page.wait_for_selector(".jp-Notebook .jp-Cell", timeout=1e3 * PATIENCE)
        page.wait_for_function(READY, arg=f"{name}.ipynb", timeout=1e3 * PATIENCE)

    def command(self, name: str) -> None:
        self.page.evaluate(f"() => {{ window.jupyterapp.commands.execute('{name}'); }}")

    def cells(self) -> list[dict[str, Any]]:
        return [cell for cell in self.page.evaluate(MODEL)["cells"] if cell["cell_type"] == "code"]

    @property
    def waiting(self) -> list[int]:
        """Places of the cells of any kind that run, or are to."""
        return [k for k, prompt in enumerate(self.page.evaluate(BUSY)) if prompt == "*"]

    def ended(self) -> None:
        _until(lambda: not self.waiting, self.text)

    def text(self) -> str:
        return json.dumps([cell["outputs"] for cell in self.cells()])

    def run_all(self) -> None:
        self.command("notebook:run-all-cells")
        _until(lambda: bool(self.waiting), self.text)
        self.ended()


@pytest.fixture
def page() -> Iterator[Any]:
    with browser() as chromium:
        yield chromium.new_page(viewport={"width": 1400, "height": 1000})


def _error(cell: dict[str, Any]) -> str:
    errors = [output for output in cell["outputs"] if output["output_type"] == "error"]
    return "".join("\n".join(error["traceback"]) for error in errors)


def test_an_interrupted_mission_stops_and_then_all_of_it_runs(lab: str, page: Any) -> None:
    notebook = Notebook(page, lab, "01_first_mission")
    (at,) = [
        k
        for k, cell in enumerate(notebook.cells())
        if "".join(cell["source"]).startswith("record = scenario.run()")
    ]
    notebook.command("notebook:run-all-cells")
    _until(
        lambda: notebook.cells()[at - 1]["execution_count"] is not None or not notebook.waiting,
        notebook.text,
    )
    time.sleep(1.0)  # into the run, or what comes before it
    notebook.command("notebook:interrupt-kernel")
    notebook.ended()
    stopped = _error(notebook.cells()[at])
    assert stopped, notebook.text()
    assert stopped.count("\n") <= 1, stopped  # one line, wherever it was
    assert all(not cell["execution_count"] for cell in notebook.cells()[at + 1 :])
    notebook.run_all()
    assert not any(_error(cell) for cell in notebook.cells()), notebook.text()
    assert all(cell["execution_count"] for cell in notebook.cells())
    assert page.locator(".jp-OutputArea-output table").count() >= 1
    assert page.locator(".jp-OutputArea-output img").count() >= 4
    frame = page.frame_locator(".jp-OutputArea-output iframe").last
    frame.locator("canvas").first.wait_for(state="visible", timeout=60e3)


def test_plans_by_priorities_run_to_the_end(lab: str, page: Any) -> None:
    notebook = Notebook(page, lab, "05_lexicographic_ocp")
    notebook.run_all()
    assert not any(_error(cell) for cell in notebook.cells()), notebook.text()
    assert all(cell["execution_count"] for cell in notebook.cells())
    page.frame_locator(".jp-OutputArea-output iframe").last.locator("canvas").first.wait_for(
        state="visible", timeout=60e3
    )


def test_scenes_share_a_viewer_and_tell_python_what_is_dragged(
    lab: str, folder: Path, page: Any
) -> None:
    notebook = Notebook(page, lab, "scenes")
    notebook.run_all()
    brought = ["class Viewer{" in json.dumps(cell["outputs"]) for cell in notebook.cells()]
    assert brought == [True, False, False, False], notebook.text()
    for k in range(3):
        page.frame_locator(".jp-OutputArea-output iframe").nth(k).locator("canvas").first.wait_for(
            state="visible", timeout=60e3
        )
    slider = (
        page.frame_locator(".jp-OutputArea-output iframe").nth(2).locator("#joints input").first
    )
    slider.wait_for(timeout=60e3)
    slider.fill("1.5")

    def told() -> bool:
        page.evaluate(
            "() => { window.jupyterapp.shell.currentWidget.content.activeCellIndex = 3; }"
        )
        notebook.command("notebook:run-cell")
        time.sleep(1.0)
        notebook.ended()
        return "1.5" in json.dumps(notebook.cells()[3]["outputs"])

    _until(told, notebook.text)
    # The same outputs in a file that nobody has signed: a picture and a sentence in place of each
    # scene.
    cells = [cell | {"source": f"{cell['source']}  # copied"} for cell in notebook.cells()]
    _write_notebook(folder / "copied.ipynb", cells)
    second_page = page.context.browser.new_page(viewport={"width": 1400, "height": 1000})
    copied = Notebook(second_page, lab, "copied")
    shown = second_page.locator(".jp-NotebookPanel:not(.lm-mod-hidden) .jp-OutputArea-output")
    _until(lambda: shown.count() >= 3, copied.text)
    assert shown.nth(0).inner_text().startswith("A scene is drawn here by scripts")
    assert shown.nth(1).inner_text().startswith("A scene is drawn here by scripts")
    assert shown.locator("iframe, script").count() == 0
    drawn = shown.locator("img").evaluate_all(
        "all => all.map((one) => one.complete && one.naturalWidth)"
    )
    assert drawn == [480] * 3
