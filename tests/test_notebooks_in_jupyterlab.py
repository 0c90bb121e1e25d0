"""Notebooks in JupyterLab, in a browser: a cell is interrupted, then all run; scene and tables are there, tracebacks are not."""

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

from uvms_ocp.viz.scene.page import browser, missing

pytestmark = [pytest.mark.slow, long_without_compiler]
if missing():
    pytest.skip(missing(), allow_module_level=True)
if find_spec("jupyterlab") is None:
    pytest.skip('jupyterlab is not installed; run: pip install "uvms-ocp[notebooks]"', allow_module_level=True)

NOTEBOOKS = Path(__file__).parents[1] / "notebooks"
TOKEN = "of-this-test"
PATIENCE = 900.0  # [s] for what compiles on a busy machine
ALL_CELLS = {"windowingMode": "none"}  # also those that nobody scrolls to
READY = "async () => { await window.jupyterapp.restored; await window.jupyterapp.shell.currentWidget.sessionContext.ready; }"
MODEL = "() => window.jupyterapp.shell.currentWidget.content.model.toJSON()"
BUSY = "() => window.jupyterapp.shell.currentWidget.content.widgets.map((cell) => (cell.prompt || '').trim())"


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a server in an empty folder, for notebooks that are copied there."""
    folder, home = tmp_path_factory.mktemp("work"), tmp_path_factory.mktemp("home")
    for name in ("01_first_mission", "05_lexicographic_ocp"):
        shutil.copy(NOTEBOOKS / f"{name}.ipynb", folder)
    settings = home / "settings" / "@jupyterlab" / "notebook-extension" / "tracker.jupyterlab-settings"
    settings.parent.mkdir(parents=True)
    settings.write_text(json.dumps(ALL_CELLS))
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    own = {"JUPYTER_CONFIG_DIR": home / "config", "JUPYTER_DATA_DIR": home / "data", "JUPYTER_RUNTIME_DIR": home / "runtime"}
    options = [f"--port={port}", "--no-browser", "--allow-root", f"--IdentityProvider.token={TOKEN}", f"--notebook-dir={folder}"]
    options += [f"--LabApp.user_settings_dir={home / 'settings'}", "--LabApp.expose_app_in_browser=True"]
    log = (home / "log").open("w")
    command = [sys.executable, "-m", "jupyterlab", *options]
    server = subprocess.Popen(command, env=os.environ | {key: str(path) for key, path in own.items()}, stdout=log, stderr=log)
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
        page.goto(f"{address}/lab/tree/{name}.ipynb?token={TOKEN}")
        page.wait_for_selector(".jp-Notebook .jp-Cell", timeout=1e3 * PATIENCE)
        page.evaluate(READY)

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
    return "".join("\n".join(output["traceback"]) for output in cell["outputs"] if output["output_type"] == "error")


def test_an_interrupted_mission_stops_and_then_all_of_it_runs(lab: str, page: Any) -> None:
    notebook = Notebook(page, lab, "01_first_mission")
    (at,) = [k for k, cell in enumerate(notebook.cells()) if "".join(cell["source"]).startswith("record = scenario.run()")]
    notebook.command("notebook:run-all-cells")
    _until(lambda: notebook.cells()[at - 1]["execution_count"] is not None or not notebook.waiting, notebook.text)
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
    page.frame_locator(".jp-OutputArea-output iframe").last.locator("canvas").first.wait_for(state="visible", timeout=60e3)
