"""A controller in C, run from Python."""

from __future__ import annotations

import ctypes
from pathlib import Path

from uvms_ocp.control.export.interface import ControllerInputs, ControllerOutputs, command_in, write_measurement
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.functions.compile import compile_library, loaded_library
from uvms_ocp.functions.kernels.layout import structure_of
from uvms_ocp.model.state import Command, Measurement

_FILES = ("controller.h", "controller.c", "initial.c", "functions.c", "solver.c")
_INCLUDE = '#include "controller.h"\n'


class CController:
    """A callable ``(Measurement, t) -> Command``, at the beginning of its mission."""

    def __init__(self, folder: Path, sizes: dict[str, int], *, forces: bool) -> None:
        """folder: where the files of C are. sizes [-]: of `interface_types`.

        forces: its commands have thrust and torque. Raises `InvalidInput` where the files cannot be compiled, or are of
        a controller for another robot or mission.
        """
        types = interface_types(sizes)
        self._inputs, self._outputs = (kind() for kind in types)
        self._forces, library = forces, _library(folder)
        size, *given = (ctypes.c_ulong * 3).in_dll(library, "CONTROLLER_SIZES")
        if given != [ctypes.sizeof(kind) for kind in types]:
            raise InvalidInput(f"{folder} is of a controller for another robot or mission; export this one")
        self._memory = ctypes.create_string_buffer(size)
        self._step = library["controller_step"]
        self._step.restype = None
        library["controller_reset"](self._memory)

    def __call__(self, measurement: Measurement, t: float) -> Command:
        """The command for the tick at time t [s]."""
        write_measurement(self._inputs, measurement, t)
        self._step(self._memory, ctypes.byref(self._inputs), ctypes.byref(self._outputs))
        return command_in(self._outputs, forces=self._forces)


def interface_types(sizes: dict[str, int]) -> tuple[type[ctypes.Structure], type[ctypes.Structure]]:
    """What is given and told at every tick, for n_q, n_v, n_joints, n_thrusters and n_quantities [-]."""
    return structure_of(ControllerInputs, **sizes), structure_of(ControllerOutputs, **sizes)


def _library(folder: Path) -> ctypes.CDLL:
    try:
        header, *files = ((folder / name).read_text(encoding="utf-8") for name in _FILES)
    except OSError as error:
        raise InvalidInput(
            f"{folder} has no controller: {error.strerror}; `uvms-ocp export controller` writes one"
        ) from None
    source, *others = (text.replace(_INCLUDE, header) for text in files)
    path = compile_library(source, name="the exported controller", others=others)
    if path is None:
        raise InvalidInput(f"the controller in {folder} cannot be compiled; give a C compiler (CC, cc, gcc, clang)")
    return loaded_library(path)
