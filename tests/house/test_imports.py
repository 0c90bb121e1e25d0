"""Importing the package, its commands too, takes no library along that only a few calls need."""

from __future__ import annotations

import importlib
import pkgutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

import uvms_ocp

EXTRAS = ("dask", "distributed", "pandas", "pyarrow", "SALib", "mcap", "mcap_protobuf", "rosbags")
RARE = ("scipy", "matplotlib", "meshcat", *EXTRAS)
_CODE = """
import pkgutil, sys, uvms_ocp, uvms_ocp.cli
for module in pkgutil.iter_modules(uvms_ocp.cli.__path__, "uvms_ocp.cli."):
    __import__(module.name)
packages = {module.name for module in pkgutil.iter_modules(uvms_ocp.__path__)}
for name in set(dir(uvms_ocp)) - packages:
    getattr(uvms_ocp, name)
print(*sys.modules)
"""
_WITHOUT = """
import sys
for name in {extras}:
    sys.modules[name] = None  # as if it was not installed
import pkgutil, uvms_ocp.campaign, uvms_ocp.cli
for module in pkgutil.iter_modules(uvms_ocp.cli.__path__, "uvms_ocp.cli."):
    __import__(module.name)
from pathlib import Path
from uvms_ocp.errors import NotInstalled
try:
    uvms_ocp.campaign.Campaign(scenario="case1", runs=1).run(Path("never"))
except NotInstalled as error:
    print(error)
"""


@pytest.fixture(scope="module")
def imported() -> set[str]:
    process = subprocess.run(
        [sys.executable, "-c", _CODE], check=True, capture_output=True, text=True
    )
    return set(process.stdout.split())


@pytest.mark.sampled
@pytest.mark.parametrize("library", RARE)
def test_what_few_calls_need_is_not_imported_at_once(imported: set[str], library: str) -> None:
    assert library not in imported


def test_packages_are_plain_modules_which_code_that_is_sent_to_workers_may_name() -> None:
    """What loads names lazily guards those that are also modules by a class of its own, which no
    pickle takes.
    """
    modules = pkgutil.walk_packages(uvms_ocp.__path__, "uvms_ocp.")
    packages = ["uvms_ocp", *(module.name for module in modules if module.ispkg)]
    assert {type(importlib.import_module(name)) for name in packages} == {ModuleType}


def test_commands_import_without_the_extras_and_a_campaign_says_which_it_needs(
    tmp_path: Path,
) -> None:
    words = [sys.executable, "-c", _WITHOUT.format(extras=EXTRAS)]
    printed = subprocess.run(words, check=True, capture_output=True, text=True, cwd=tmp_path).stdout
    assert printed.strip().endswith('pip install "uvms-ocp[campaign]"')
    assert not list(tmp_path.iterdir())


def test_the_package_itself_loads_no_more_than_its_names_before_it_is_asked_for() -> None:
    code = "import sys, uvms_ocp; print(*sys.modules)"
    loaded = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True
    ).stdout.split()
    assert not {"numpy", "casadi", "pinocchio", "coal", "scipy"} & set(loaded)
    own_modules = {name for name in loaded if name.startswith("uvms_ocp")}
    assert own_modules == {"uvms_ocp", "uvms_ocp.lazy_names", "uvms_ocp.interrupts"}


def test_an_unknown_public_name_is_answered_with_the_nearest() -> None:
    import uvms_ocp

    with pytest.raises(AttributeError, match="did you mean 'load_robot'"):
        uvms_ocp.load_robt  # noqa: B018 - the look-up is what is tested
    assert "load_robot" in dir(uvms_ocp)
