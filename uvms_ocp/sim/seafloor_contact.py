"""Contact of the vehicle's hull with the seafloor: a spring and damper at each corner of its
underside.

The floor pushes and never pulls; friction is Coulomb's, regularised below a creeping speed.
"""

from __future__ import annotations

import casadi as ca

from uvms_ocp.checks import checked_dataclass
from uvms_ocp.types import Positive


@checked_dataclass()
class ContactModel:
    """Stiffness and damping per corner. Raises `InvalidInput` for a number that is not > 0.

    The values are assumed: no public measurement of a skid on sediment. They are the sediment's, and
    thus the same for vehicles of any size.
    """

    stiffness: Positive = 2e4
    """[N/m] Stiffness of the floor at a corner."""
    damping: Positive = 2e3
    """[N s/m] Damping of the floor at a corner."""
    friction: Positive = 0.5
    """[-] Coefficient of friction."""
    creep: Positive = 0.01
    """[m/s] Speed below which friction is viscous."""

    def force(
        self, depth: ca.SX, velocity_W: ca.SX, normal_W: ca.SX, dt: ca.SX
    ) -> tuple[ca.SX, ca.SX]:
        """Return the force (3,) [N] in W on a point `depth` [m] below the floor that moves with
        velocity_W (3,) [m/s], and its slope.

        The slope (3, 3) [N s/m], minus the derivative with respect to velocity over a step dt [s],
        makes the step implicit.
        """
        speed = ca.dot(velocity_W, normal_W)
        damping = self.damping + dt * self.stiffness
        pressing = ca.if_else(depth > 0, ca.fmax(self.stiffness * depth - damping * speed, 0), 0)
        sliding = velocity_W - speed * normal_W
        grip = self.friction * pressing / ca.sqrt(ca.sumsqr(sliding) + self.creep**2)
        across = ca.SX.eye(3) - normal_W @ normal_W.T
        slope = ca.if_else(pressing > 0, damping, 0) * (normal_W @ normal_W.T) + grip * across
        return pressing * normal_W - grip * sliding, slope
