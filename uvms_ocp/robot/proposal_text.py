"""Lines of a proposed hydrodynamics.yaml, each with where its values come from."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import yaml

from uvms_ocp.robot.description import RobotDescription
from uvms_ocp.robot.proposal_draft import SPIN_UP, ProposalDraft
from uvms_ocp.robot.proposed_hull import ADDED_MASS_INTERVAL, DRAG_INTERVAL

_HEAD = """# What the URDF does not say: water, thrusters, limits. SI units; vectors in the frame of their link, forward-left-up.
# Everything here is proposed, from the URDF alone: look at each line, and replace what you know.
# `uvms-ocp schema` prints all that may stand here."""
_BY_USER = "as you said"
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
        yield "vehicle_limits: # proposed: of a slow vehicle; surge, sway, heave, roll, pitch, yaw"
        for key, row in values["vehicle_limits"].items():
            yield f"  {key}: {_flow(row)}"
    if description.joints:
        rotors = (
            f"rotors that full effort alone brings there in {SPIN_UP:g} s, or as heavy as the arm"
        )
        yield (
            "joints: # proposed: half a second to full speed, or 1 where the URDF has no limit of"
            f" it; {rotors}"
        )
        for name, entry in values["joints"].items():
            yield f"  {_flow(name)}: {_flow(entry)}"
    trimmed_link = "" if "volume" in draft.stated_of(hull) else hull
    yield from _link_lines(values["links"], sources, trimmed_link)
    if description.thrusters:
        yield (
            "thrusters: # proposed: places and directions of the URDF; limits as vehicles of this"
            " mass have them"
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
            source = " # proposed: so that it floats level" if is_trim else ""
            yield f"      {key}: {_flow(value)}{source}"


def intervals_of_water() -> str:
    """Return how far added mass and drag that are proposed may be off."""
    added_low, added_high = ADDED_MASS_INTERVAL
    drag_low, drag_high = DRAG_INTERVAL
    return (
        f"proposed by shapes: added mass may be {added_low:g} to {added_high:g} times as large, drag"
        f" {drag_low:g} to {drag_high:g} times; published vehicles are, in nine of ten entries"
    )


def _flow(value: Any) -> str:
    """Return a value on one line of YAML."""
    text = yaml.safe_dump(
        value, default_flow_style=True, width=100_000, sort_keys=False, allow_unicode=True
    )
    return text.removesuffix("\n").removesuffix("\n...").strip()
