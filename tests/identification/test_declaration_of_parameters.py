"""Whatever their coordinates, quantities are those of a vehicle; what is encoded is decoded."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from vehicles import HULL, declaration, vehicle

from uvms_ocp.errors import InvalidInput, NameNotFound
from uvms_ocp.identification.coordinates import PositiveDefinite, second_moment
from uvms_ocp.identification.parameters import (
    Bounded,
    Fixed,
    Free,
    Prior,
    Quantity,
    Unknowns,
)
from uvms_ocp.identification.vehicle_declaration import (
    ActuatorModel,
    NominalParameters,
    vehicle_declaration,
)
from uvms_ocp.robot.hydrodynamics import LinkHydrodynamics

FREE = ("mass", "centre_of_mass", "second_moment", "volume", "centre_of_buoyancy")
WET = ("added_mass", "linear_drag", "quadratic_drag")


def pseudo_inertia(mass: ca.SX, centre: ca.SX, S: ca.SX) -> ca.SX:
    """(4, 4) [kg m2, kg m, kg] positive definite for a positive mass [kg] and S (3, 3) [kg m2],
    whatever the centre (3,) [m].
    """
    first = mass * centre
    return ca.vertcat(ca.horzcat(S + first @ centre.T, first), ca.horzcat(first.T, mass))


def values_at(layout: Unknowns, theta: np.ndarray) -> dict[str, np.ndarray]:
    return {
        name: np.asarray(ca.DM(value)) for name, value in layout.values(ca.SX(ca.DM(theta))).items()
    }


def everything_free() -> Unknowns:
    return Unknowns(declaration().with_status(**dict.fromkeys((*FREE, *WET), Free())))


@pytest.mark.parametrize("seed", range(40))
def test_any_coordinates_are_those_of_a_vehicle(seed: int) -> None:
    rng = np.random.default_rng(seed)
    layout = everything_free()
    theta = layout.start + rng.normal(scale=rng.choice([0.1, 1.0, 2.0]), size=len(layout.start))
    values = values_at(layout, theta)
    J = np.asarray(ca.DM(pseudo_inertia(*(ca.SX(ca.DM(values[name])) for name in FREE[:3]))))
    unit = 1.0 / np.sqrt(np.diag(J))
    assert np.linalg.eigvalsh(unit[:, None] * J * unit).min() > 0.0
    assert (HULL[0] <= values["centre_of_buoyancy"].ravel()).all()
    assert (values["centre_of_buoyancy"].ravel() <= HULL[1]).all()
    # It refuses an indefinite added mass and drag that feeds energy at any velocity.
    LinkHydrodynamics(
        frame="base_link",
        volume=float(values["volume"][0, 0]),
        **{name: values[name] for name in WET},
    )


@pytest.mark.parametrize("name", [*FREE, *WET])
def test_what_is_encoded_is_decoded(name: str) -> None:
    one = declaration().quantities[name]
    rng = np.random.default_rng(3)
    x = one.x + 0.5 * rng.normal(size=len(one.x))
    value = np.asarray(ca.DM(one.coordinates.decode(ca.SX(ca.DM(x)))))
    shaped = value if min(value.shape) > 1 else value.ravel()
    np.testing.assert_allclose(one.coordinates.encode(shaped), x, atol=1e-9)


def test_a_declaration_starts_from_the_numbers_of_the_model() -> None:
    model = vehicle()
    values = values_at(Unknowns(declaration()), np.zeros(0))
    wet = model.links[0]
    body = model.model.inertias[1]
    np.testing.assert_allclose(values["mass"], body.mass)
    np.testing.assert_allclose(
        values["second_moment"], second_moment(np.asarray(body.inertia)), atol=1e-15
    )
    for name in WET:
        np.testing.assert_allclose(values[name], getattr(wet, name), atol=1e-12)
    np.testing.assert_allclose(values["centre_of_buoyancy"].ravel(), wet.p_LB, atol=1e-15)


def test_only_what_is_free_is_an_unknown() -> None:
    known = declaration().with_status(
        mass=Prior(sigma=0.1),
        linear_drag=Free(only=("surge", "yaw")),
        bias=Bounded(lower=-3.0, upper=2.0),
    )
    layout = Unknowns(known.with_status(bias=Fixed(only=("yaw",))))
    axes = ("surge", "sway", "heave", "roll", "pitch")
    assert layout.names == (
        "mass",
        "linear_drag surge",
        "linear_drag yaw",
        *(f"bias {axis}" for axis in axes),
    )
    np.testing.assert_allclose(layout.sigma[:2], [0.1, np.inf])
    np.testing.assert_allclose(layout.lower[-1], -3.0)
    np.testing.assert_allclose(np.exp(layout.start[0]), 20.0)


def test_what_recordings_have_for_themselves_is_apart() -> None:
    known = declaration().with_status(mass=Free(), current=Free(only=("x", "y")))
    assert Unknowns(known).names == ("mass",)
    assert Unknowns(known, per_recording=True).names == ("current x", "current y")


def test_a_body_that_cannot_be_is_refused() -> None:
    with pytest.raises(InvalidInput, match="sum of the other two"):
        second_moment(np.diag([1.0, 1.0, 3.0]))


def test_unknown_names_are_told_what_there_is() -> None:
    with pytest.raises(NameNotFound, match="Did you mean 'added_mass'"):
        declaration().with_status(added_mas=Free())
    with pytest.raises(NameNotFound, match="Did you mean 'surge'"):
        declaration().with_status(added_mass=Free(only=("surg",)))


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: Bounded(lower=1.0, upper=1.0), "lower < upper"),
        (lambda: Prior(sigma=0.0), "give a number > 0"),
        (lambda: declaration().with_start(mass=np.array([-1.0])), "more than 0"),
        (
            lambda: declaration().with_start(centre_of_buoyancy=np.array([0.0, 0.0, 0.5])),
            "strictly inside",
        ),
        (lambda: declaration().with_start(linear_drag=-np.eye(6)), "not positive definite"),
        (
            lambda: declaration().with_status(bias=Bounded(lower=1.0, upper=2.0)),
            "around what the value is",
        ),
        (lambda: declaration().with_start(bias=np.zeros(3)), "shape"),
    ],
)
def test_mistakes_are_named(make: object, text: str) -> None:
    with pytest.raises(InvalidInput, match=text):
        make()  # type: ignore[operator]


def test_axes_without_a_scale_stay_without_a_value() -> None:
    flat = PositiveDefinite(
        axes=("a", "b", "c"), scale=np.array([2.0, 0.0, 3.0]), couplings=((2, 0),)
    )
    one = Quantity.fixed("kg", flat, np.diag([4.0, 0.0, 9.0]))
    assert flat.names == ("a", "c", "c-a")
    np.testing.assert_allclose(
        np.asarray(ca.DM(flat.decode(ca.SX(ca.DM(one.x))))), np.diag([4.0, 0.0, 9.0])
    )


@pytest.mark.parametrize("name", ["delay", "velocity_delay"])
def test_a_delay_is_nothing_unless_it_is_given_or_learnt(name: str) -> None:
    start = NominalParameters.of(vehicle())
    declared = vehicle_declaration(start, HULL, ActuatorModel(delay=0.0))
    fixed = declared.quantities[name]
    free = declared.with_status(**{name: Free()}).quantities[name]
    late = [
        float(ca.DM(ca.evalf(one.coordinates.decode(ca.SX(ca.DM(one.x)))))) for one in (fixed, free)
    ]
    assert late[0] < 1e-5  # [s]
    assert 0.9e-3 < late[1] < 0.011  # inside the interval, from where a search leads to either side
