"""Colours of the scene, on dark water. Parts from 0 to 1, or as style sheets write them.

Floor, water, light and phases have theirs in `assets/stage.js`, alarms and lost sensors in
`assets/time.js`.
"""

from __future__ import annotations

Colour = tuple[float, float, float]

VEHICLE_TRAIL: Colour = (1.0, 0.82, 0.2)
TOOL_TRAILS: tuple[Colour, ...] = (
    (0.95, 0.25, 0.55),
    (0.45, 0.95, 0.6),
    (0.7, 0.6, 1.0),
)
"""Colours of the trails of tools; the last of all further ones."""
MARKERS: tuple[Colour, ...] = (
    (0.95, 0.3, 0.1),
    (0.2, 0.85, 0.45),
    (0.95, 0.85, 0.2),
    (0.6, 0.4, 0.9),
)
"""Colours of markers, such as goals, one after the other."""
TRIAD: tuple[Colour, ...] = ((0.85, 0.15, 0.1), (0.1, 0.65, 0.2), (0.15, 0.35, 0.9))
"""Colours of the axes x, y and z of a frame."""
OBSTACLE = (0.85, 0.45, 0.2, 0.55)
"""Colour of obstacles, and their opacity."""
BEAM: Colour = (0.5, 1.0, 0.9)
"""Colour of the altimeter's beam."""
DISTANCE = "#ffe066"
"""Colour of the lines between the robot and what is near."""
GHOSTS: tuple[Colour, ...] = (
    (0.35, 0.85, 1.0),
    (1.0, 0.6, 0.25),
    (0.75, 0.6, 1.0),
    (0.5, 0.95, 0.55),
)
"""Colours of other motions beside the record's; more cannot be told apart."""
GHOST_OPACITY = 0.32
ARROW_THRUST = "#b8f23c"
ARROW_CONTACT = "#ff6b5e"
ARROW_CURRENT = "#63e6ff"
ARROW_FORCE = "#ff7ad9"
ARROW_MOMENT = "#c9a0ff"
