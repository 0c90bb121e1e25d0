"""A reading that goes back by what its channel jumped by is believed once, and not long after."""

from __future__ import annotations

import pytest

from uvms_ocp.codegen.kernel_layout import structure_of
from uvms_ocp.codegen.kernels import bind_kernels
from uvms_ocp.estimation.health.channel_state import ChannelMemory, accept, reject, undoes_jump

JUMP = 20.0  # [m]
JUMPED_AT = 3.0  # [s]


class FixChannel:
    """Position fixes that are accepted where they were at first, and after a jump."""

    def __init__(self) -> None:
        structure = structure_of(ChannelMemory, n_width=3)
        self.memory = structure()
        self.memory.size = 3
        self.memory.gate.noise = 0.1
        self.complaint = type(self.memory.complaint)()
        self._accept, self._reject, self._undoes_jump = bind_kernels(
            (accept, reject, undoes_jump), (structure, type(self.complaint))
        )
        self.accept(0.0, 0.0)
        self._reject(self.memory, self.complaint, self.read(JUMP, JUMPED_AT - 2.0))
        self._reject(self.memory, self.complaint, self.read(JUMP, JUMPED_AT - 1.0))
        self.accept(JUMP, JUMPED_AT)

    def read(self, offset: float, t: float) -> float:
        """Take a reading that is off the estimate by the offset [m] at time t [s]; return t."""
        self.memory.offset[0] = offset
        self.memory.off = abs(offset)
        self.memory.stamp = t
        return t

    def accept(self, offset: float, t: float) -> None:
        self._accept(self.memory, self.read(offset, t))

    def is_believed(self, offset: float, t: float) -> bool:
        self.read(offset, t)
        return bool(self._undoes_jump(self.memory))


def test_fixes_that_went_back_are_not_believed_when_they_jump_there_again() -> None:
    """They were, for the rest of the run, where none was refused on the way back."""
    fixes = FixChannel()
    assert fixes.is_believed(-JUMP, 8.0)
    fixes.accept(-JUMP, 8.0)
    fixes.accept(0.0, 9.0)
    assert not fixes.is_believed(-JUMP, 20.0)


@pytest.mark.parametrize("t", [10.0, 50.0])
def test_noise_after_a_jump_is_no_way_back(t: float) -> None:
    fixes = FixChannel()
    for k in range(5):
        fixes.accept(0.09 * (-1) ** k, JUMPED_AT + 1.0 + k)
    assert fixes.is_believed(-JUMP, t)


def test_a_jump_is_forgotten_after_a_minute() -> None:
    """A fix that was off the other way was believed without a gate for the rest of the run."""
    assert FixChannel().is_believed(-JUMP, JUMPED_AT + 59.0)
    assert not FixChannel().is_believed(-JUMP, JUMPED_AT + 61.0)
