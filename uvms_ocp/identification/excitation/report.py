"""A design in words: where it leads, and what one recording of it is expected to determine."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from uvms_ocp.identification.excitation.expected import Excitation


def excitation_text(one: Excitation, actuators: Sequence[str]) -> str:
    """Markdown."""
    return "\n".join(["# Excitation", "", *_course(one, actuators), "", *_numbers(one)]) + "\n"


def _course(one: Excitation, actuators: Sequence[str]) -> Iterator[str]:
    spans = [f"{low:+.2f} to {high:+.2f}" for low, high in one.swept.T]
    step = float(one.commands.t[1] - one.commands.t[0])
    tilt = 2.0 * np.arcsin(np.hypot(*one.states[:, 3:5].T).max())
    yield f"{one.status.value}: {one.status.advice}\n"
    yield f"Commands last {step * len(one.commands.t):.4g} s, held for {step:.4g} s each, of {', '.join(actuators)}.\n"
    yield f"From where its origin begins the hull sweeps {', '.join(spans)} m in x, y and z, and tilts by {tilt:.2f} rad at most,"
    yield "if the vehicle is as it is believed to be: keep it in sight, and record what was told if someone interferes."


def _numbers(one: Excitation) -> Iterator[str]:
    yield "| number | believed | unit | standard error | determined |"
    yield "|---|---:|---|---:|---|"
    for each in one.numbers:
        word = "yes" if each.determined else "no"
        yield f"| {each.name} | {each.value:.4g} | {each.unit} | {each.sigma:.2g} | {word} |"
