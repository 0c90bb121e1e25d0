"""Run an exported controller in C from Python, and record what a controller of Python gets and
gives.
"""

from __future__ import annotations

import ctypes
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from uvms_ocp.codegen.kernel_layout import arrays_of, structure_of, view
from uvms_ocp.codegen.libraries import compile_library
from uvms_ocp.codegen.loading import loaded_library
from uvms_ocp.control import KinematicController
from uvms_ocp.errors import InvalidInput
from uvms_ocp.export import tick as exported_tick
from uvms_ocp.export.c_files import SOURCES, file_names
from uvms_ocp.export.tick import ControllerInputs, ControllerOutputs
from uvms_ocp.robot.dimensions import Dimensions
from uvms_ocp.robot.signals import Command, StateEstimate

_TELEMETRY = ("phase", "freshness", "status", "viable_share")


class CController:
    """Exported controller, a callable ``(StateEstimate, t) -> Command``, at the beginning of its
    mission.
    """

    def __init__(self, folder: Path, name: str, dimensions: Dimensions, *, forces: bool) -> None:
        """folder: where the files of C are. name: of the export. dimensions: of `interface_types`.

        forces: its commands have thrust and torque. Raises `InvalidInput` where the files cannot be
        compiled, or are of a controller for another robot or mission.
        """
        types: Any = interface_types(dimensions)
        inputs_type, outputs_type = types
        self._inputs = inputs_type()
        self._outputs = outputs_type()
        self._output_arrays = arrays_of(self._outputs)
        self._forces = forces
        texts = _texts(folder, name)
        library = _library(folder, name, texts)
        prefix = _symbol_prefix(folder, name, texts["controller.h"])
        size, *interface = (ctypes.c_ulong * 3).in_dll(library, f"{prefix}CONTROLLER_SIZES")
        if interface != [ctypes.sizeof(inputs_type), ctypes.sizeof(outputs_type)]:
            raise InvalidInput(
                f"{folder} is of a controller for another robot or mission; export this one"
            )
        self._memory = ctypes.create_string_buffer(size)
        self._step = library[f"{prefix}controller_step"]
        self._step.restype = None
        library[f"{prefix}controller_reset"](self._memory)

    def __call__(self, estimate: StateEstimate, t: float) -> Command:
        """Return the command for the tick at time t [s]."""
        exported_tick.write_measurement(self._inputs, estimate, t)
        self._step(self._memory, ctypes.byref(self._inputs), ctypes.byref(self._outputs))
        return exported_tick.command_in(self._outputs, self._output_arrays, forces=self._forces)


def interface_types(
    dimensions: Dimensions,
) -> tuple[type[ControllerInputs], type[ControllerOutputs]]:
    """Return the structures of inputs and outputs."""
    return structure_of(ControllerInputs, dimensions), structure_of(ControllerOutputs, dimensions)


def only_name(folder: Path) -> str:
    """Return the name of the export in a folder. Raises `InvalidInput` for none, and for
    several.
    """
    names = sorted(
        path.name.removesuffix("_controller.h") for path in folder.glob("*_controller.h")
    )
    if not names:
        raise InvalidInput(f"{folder} has no controller; `uvms-ocp export controller` writes one")
    if len(names) > 1:
        raise InvalidInput(
            f"{folder} has {len(names)} controllers; give the name of one: {', '.join(names)}"
        )
    return names[0]


def _texts(folder: Path, name: str) -> dict[str, str]:
    called = file_names(name)
    try:
        return {file: (folder / called[file]).read_text(encoding="utf-8") for file in SOURCES}
    except OSError as error:
        raise InvalidInput(
            f"{folder} has no controller {name}: {error.strerror}; `uvms-ocp export controller`"
            " writes one"
        ) from None


def _symbol_prefix(folder: Path, name: str, header: str) -> str:
    """Return what the header puts before all symbols."""
    defined = re.search(rf"^#define {name}_controller_step (\w+)controller_step$", header, re.M)
    if defined is None:
        raise InvalidInput(f"the controller in {folder} is of another version; export it anew")
    return defined[1]


def _library(folder: Path, name: str, texts: dict[str, str]) -> ctypes.CDLL:
    header, *files = (texts[file] for file in SOURCES)
    include = f'#include "{file_names(name)["controller.h"]}"\n'
    source, *other_sources = (text.replace(include, header) for text in files)
    path = compile_library(source, name="the exported controller", others=other_sources)
    if path is None:
        raise InvalidInput(
            f"the controller in {folder} cannot be compiled; give a C compiler (CC, cc, gcc, clang)"
        )
    return loaded_library(path)


class RecordingController:
    """Record of a controller: for each tick, `ControllerInputs` and `ControllerOutputs` as
    numbers.
    """

    def __init__(
        self,
        controller: Callable[[StateEstimate, float], Command],
        kinematic: KinematicController,
        inputs: ControllerInputs,
        outputs: ControllerOutputs,
    ) -> None:
        """inputs, outputs: structures through which the numbers go."""
        self.kinematic = kinematic
        """The layer below."""
        self._controller = controller
        self._inputs = inputs
        self._outputs = outputs
        self.ticks: list[list[float]] = []
        """(n,) each [in their units]."""

    def __call__(self, estimate: StateEstimate, t: float) -> Command:
        """Return the command for the tick at time t [s]."""
        exported_tick.write_measurement(self._inputs, estimate, t)
        command = self._controller(estimate, t)
        _write_command(self._outputs, command)
        self.ticks.append([*numbers_in(self._inputs), *numbers_in(self._outputs)])
        return command

    def as_bytes(self) -> bytes:
        """Return the ticks as little-endian doubles."""
        return np.array(self.ticks).astype("<f8").tobytes()


def _write_command(outputs: Any, command: Command) -> None:
    view(outputs.v)[:] = command.v
    if command.thrust is not None and command.torque is not None:
        outputs.thrust[: len(command.thrust)] = command.thrust.tolist()
        outputs.torque[: len(command.torque)] = command.torque.tolist()
    for name in ("hold", "stop", "brakes", "finished"):
        setattr(outputs, name, getattr(command, name))
    for name in _TELEMETRY:
        setattr(outputs, name, command.telemetry[name])
    quantities = command.telemetry["quantities"]
    outputs.quantities[: len(quantities)] = quantities.tolist()


def numbers_in(value: Any) -> Iterator[float]:
    """Yield all numbers of a structure, field after field."""
    if isinstance(value, ctypes.Structure):
        for name, *_ in value._fields_:
            yield from numbers_in(getattr(value, name))
    elif isinstance(value, ctypes.Array):
        for item in value:
            yield from numbers_in(item)
    else:
        yield value
