"""Lines of a proposed hydrodynamics.yaml, each with where its values come from."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import Any

import yaml

from uvms_ocp.robot.description import RobotDescription
from uvms_ocp.robot.proposal_draft import SPIN_UP, ProposalDraft
from uvms_ocp.robot.proposed_hull import ADDED_MASS_INTERVAL, DRAG_INTERVAL
from uvms_ocp.robot.proposed_water import LIFT_SHARE, TURBULENT_RATE, TURBULENT_SPEED

_HEAD = """# What the URDF does not say: water, thrusters, limits. SI units; vectors in the frame of their link, forward-left-up.
# Everything here is proposed, from the URDF alone: look at each line, and replace what you know.
# `uvms-ocp schema` prints all that may stand here."""
_BY_USER = "as you said"
_LIFT_SHARES = (0.1, 0.2)
"""`LIFT_SHARE` of published vehicles from 11 to 1,900 kg."""
_LOADING_SOURCES = {
    "mimic": _BY_USER,
    "lock": (
        "propellers, sensors, fingers that mimic none, what has no mass or no <limit>: these do"
        " not move here"
    ),
    "meshes": "some that matter for contact cannot be read",
    "drop": _BY_USER,
}


def proposal_lines(
    description: RobotDescription, draft: ProposalDraft, sources: Mapping[str, str], hull: str
) -> Iterator[str]:
    """Yield the lines of the file; sources: of the coefficients of links, by name."""
    values = description.model_dump(mode="json", exclude_unset=True)
    yield _HEAD
    yield from _role_lines(description, values, draft)
    yield from _loading_lines(values.get("loading", {}))
    if description.vehicle_limits:
        yield (
            "vehicle_limits: # proposed, assumed: of a slow vehicle; surge, sway, heave, roll,"
            " pitch, yaw"
        )
        for key, row in values["vehicle_limits"].items():
            yield f"  {key}: {_flow(row)}"
    if description.joints:
        rotors = (
            f"rotors that full effort alone brings there in {SPIN_UP:g} s, or as heavy as the arm"
        )
        yield (
            "joints: # proposed, assumed: half a second to full speed, or 1 where the URDF has no"
            f" limit of it; {rotors}"
        )
        for name, entry in values["joints"].items():
            yield f"  {_flow(name)}: {_flow(entry)}"
    trimmed_link = "" if "volume" in draft.stated_of(hull) else hull
    yield from _link_lines(values["links"], sources, trimmed_link)
    if description.thrusters:
        yield (
            "thrusters: # proposed: places and directions of the URDF; limits and time constants that"
            " it does not state are assumed, as vehicles of this mass have them"
        )
        for entry, thruster in zip(values["thrusters"], draft.thrusters, strict=True):
            yield f"  - {_flow(entry)} # {thruster.source}"


def _role_lines(
    description: RobotDescription, values: Mapping[str, Any], draft: ProposalDraft
) -> Iterator[str]:
    """Yield base, water, tools, open questions and sensors."""
    kind = "what floats" if draft.floats else "an arm that stands on something"
    yield f"base: {values['base']} # proposed: {kind}"
    density_source = "proposed: the sea; fresh water has 998"
    if draft.simulator.density:
        density_source = "as the file states for a simulator"
    yield f"water_density: {description.water_density} # {density_source}"
    if description.base_link:
        yield (
            f"base_link: {_flow(description.base_link)} # proposed: the root, which stands for the"
            " vehicle"
        )
    if draft.tools:
        source = "proposed: the end of each chain; the first is `tool` of tasks"
        if draft.requested_tools:
            source = _BY_USER
        yield f"tool: {_flow(values['tool'])} # {source}"
    for question in draft.questions():
        yield f"# {question}"
    if description.altimeter:
        source = "proposed: by its name, as it looks down along its -z"
        if draft.requested_altimeter:
            source = _BY_USER
        yield f"altimeter: {_flow(description.altimeter)} # {source}"
    if description.dvl:
        source = _BY_USER if draft.requested_dvl else "proposed: by its name"
        yield f"dvl: {_flow(description.dvl)} # {source}"


def _loading_lines(loading: Mapping[str, Any]) -> Iterator[str]:
    if not loading:
        return
    yield "loading: # proposed: how the URDF is read"
    for key, value in loading.items():
        yield f"  {key}: {_flow(value)} # {_LOADING_SOURCES[key]}"


def _link_lines(
    links: Mapping[str, Any], sources: Mapping[str, str], trimmed_link: str
) -> Iterator[str]:
    yield f"links: # {intervals_of_water()}"
    for name, link in links.items():
        yield f"  {_flow(name)}: # {sources.get(name, '')}"
        coefficients = link["coefficients"]
        yield f"    coefficients:{'' if coefficients else ' {}'}"
        for key, value in coefficients.items():
            is_trim = key == "volume" and name == trimmed_link
            source = ""
            if is_trim:
                source = " # proposed: so that it floats level"
            elif key == "centre_of_buoyancy" and name == trimmed_link:
                source = f" # proposed: {interval_of_buoyancy()}"
            yield f"      {key}: {_flow(value)}{source}"


def intervals_of_water(stated: Collection[str] = ()) -> str:
    """Return how far coefficients that are proposed by shapes may be off; "" where all are stated.

    stated: coefficients that the file states.
    """
    intervals = list[str]()
    if "added_mass" not in stated:
        low, high = ADDED_MASS_INTERVAL
        intervals.append(f"added mass may be {low:g} to {high:g} times as large")
    if "quadratic_drag" not in stated:
        low, high = DRAG_INTERVAL
        intervals.append(f"quadratic drag {low:g} to {high:g} times")
    sentences = list[str]()
    if intervals:
        sentences.append(f"{', '.join(intervals)}; published vehicles are, in nine of ten entries")
    if "linear_drag" not in stated:
        sentences.append(
            f"linear drag is assumed: as large as quadratic drag at {TURBULENT_SPEED:g} m/s and"
            f" {TURBULENT_RATE:g} rad/s"
        )
    if not sentences:
        return ""
    return f"proposed by shapes: {'; '.join(sentences)}"


def interval_of_buoyancy() -> str:
    """Return how far the height of buoyancy that is proposed may be off."""
    low, high = _LIFT_SHARES
    return (
        f"buoyancy {LIFT_SHARE:g} of the hull's height above the mass; may be"
        f" {low / LIFT_SHARE:.2g} to {high / LIFT_SHARE:.2g} times as high above it"
    )


def assumed_numbers(description: RobotDescription, draft: ProposalDraft) -> str:
    """Return which numbers of a proposal are assumed, without an interval; "" for none."""
    kinds = list[str]()
    if description.vehicle_limits:
        kinds.append("speeds and accelerations of the vehicle")
    if description.joints:
        kinds.append("accelerations and rotors of joints")
    if any(thruster.maximum is None for thruster in draft.thrusters):
        kinds.append("limits of thrust")
    if any(thruster.time_constant is None for thruster in draft.thrusters):
        kinds.append("time constants of thrusters")
    return ", ".join(kinds)


def _flow(value: Any) -> str:
    """Return a value on one line of YAML."""
    text = yaml.safe_dump(
        value, default_flow_style=True, width=100_000, sort_keys=False, allow_unicode=True
    )
    return text.removesuffix("\n").removesuffix("\n...").strip()
