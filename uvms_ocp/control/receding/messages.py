"""Requests and answers between processes, as plain tuples of arrays: a third of the time that values of their own take."""

from __future__ import annotations

from typing import Any, TypeAlias

from uvms_ocp.arguments import trusted
from uvms_ocp.control.receding.replanning import Answer, Planned, Request
from uvms_ocp.model.state import State
from uvms_ocp.ocp.trajectory import Trajectory

_state, _trajectory = trusted(State), trusted(Trajectory)
_FIELDS = ("t", "q", "v", "a", "thrust", "torque", "of_wrench")
Message: TypeAlias = tuple[Any, ...]


def request_message(request: Request) -> Message:
    """As it is sent."""
    return request.state.q, request.state.v, request.t, request.in_use, request.begin, request.delay


def request_of(message: Message) -> Request:
    """As it was."""
    q, v, t, in_use, begin, delay = message
    return Request(state=_state(q=q, v=v), t=t, in_use=in_use, begin=begin, delay=delay)


def answer_message(answer: Answer) -> Message:
    """As it is sent."""
    plan, numbers = answer.planned, (answer.first, answer.solve_time, answer.processor_time)
    if plan is None:
        return numbers
    return (*numbers, plan.number, plan.begin, *(getattr(plan.trajectory, name) for name in _FIELDS))


def answer_of(message: Message) -> Answer:
    """As it was."""
    first, solve_time, processor_time, *plan = message
    planned = None
    if plan:
        trajectory = _trajectory(**dict(zip(_FIELDS, plan[2:], strict=True)))
        planned = Planned(number=plan[0], begin=plan[1], trajectory=trajectory)
    return Answer(planned=planned, first=first, solve_time=solve_time, processor_time=processor_time)
