"""The stages of a horizon: its steps, the turn from one phase to the next, and the last node.

A turn takes no time. There the rows count that end a phase, and the length of the steps of the next phase is chosen: as a
control, so that it is a state of the steps that follow and couples nothing else.
"""

from __future__ import annotations

from dataclasses import dataclass

from uvms_ocp.ocp.problem import OcpProblem


@dataclass(frozen=True, kw_only=True, slots=True)
class Stage:
    """One stage."""

    node: int
    """[-] whose state it has."""
    block: int | None
    """[-] `TermBlock` whose rows count; None for a turn before the first phase."""
    place: int = 0
    """[-] of the node in that block."""
    step: bool = False
    """It takes time, and has accelerations."""
    turn_to: int | None = None
    """[-] phase that begins."""


def chain(problem: OcpProblem) -> tuple[Stage, ...]:
    """The stages of a problem, the last node last."""
    starts, n = problem.starts_of_phases().tolist(), len(problem.phases)
    stages: list[Stage] = []
    for i in range(n):
        if i or problem.free_time:
            stages.append(Stage(node=starts[i], block=n + i - 1 if i else None, turn_to=i))
        stages += [
            Stage(node=node, block=i, place=node - starts[i], step=True) for node in range(starts[i], starts[i + 1])
        ]
    return (*stages, Stage(node=starts[n], block=2 * n - 1))
