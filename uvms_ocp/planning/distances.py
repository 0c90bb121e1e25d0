"""Signed distances of all pairs of a scene along many configurations, by coal, with exact
gradients.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Annotated

import numpy as np
import pinocchio as pin

from uvms_ocp.checks import checked_constructor, checked_dataclass
from uvms_ocp.errors import InvalidInput
from uvms_ocp.planning.scene import CollisionScene
from uvms_ocp.robot import kinematics, robot
from uvms_ocp.robot.shapes.pair_distances import FAILED, distance_data
from uvms_ocp.robot.shapes.signed_distance import SignedDistances
from uvms_ocp.types import Array, Indices, Mask, Shape

Configurations = Annotated[Array, Shape("n", "self.scene.coordinates.robot.n_q")]
ChosenPairs = Annotated[Mask, Shape("n", "self.scene.n_pairs")]
"""(n, n_pairs) True for the pairs that are asked for at each configuration."""
Samples = Annotated[Array, Shape("n", "self.scene.coordinates.n_axes")]
_Contact = tuple[int, int, float, Array, Array, Array]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class NearPairs:
    """The pairs closer than a threshold, one row per sample and pair, in the order of the
    samples.
    """

    sample: Indices
    """(n,) index of the sample of each pair."""
    pair: Indices
    """(n,) index of the pair in the scene."""
    distance: Array
    """(n,) [m] distance, negative where they overlap."""
    gradient: Array
    """(n, n_axes) [m per unit of the axis] derivative of the distance."""
    screws: Array
    """(n, 6, n_columns) [m and rad per unit of the axis] twist of the whole robot at the world
    origin, linear rows first.
    """
    centre: Array
    """(n, 3) [m] origin of the pair's second shape in W."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Contacts:
    """Contacts of the nearest pairs: one row per sample and pair, the samples in their order."""

    sample: Indices
    """(n,) index of the sample of each contact."""
    pair: Indices
    """(n,) index of the pair in the scene."""
    distance: Array
    """(n,) [m] signed."""
    normal: Array
    """(n, 3) unit vectors in W, from the first shape to the second."""
    first: Array
    """(n, 3) [m] nearest points in W on the first shapes."""
    second: Array
    """(n, 3) [m] nearest points in W on the second shapes."""


@dataclass(slots=True, eq=False)
class _Bounds:
    """Lower bounds of the distances at the samples of the last call, carried along by the reach of
    every axis.
    """

    x: Array
    """(n, n_axes) [m, rad] configurations at the samples."""
    lower: Array
    """(n, n_pairs) [m] lower bounds."""

    def moved_to(self, x: Array, scene: CollisionScene) -> None:
        """Return the bounds at x: unknown for a new set of samples, else reduced by what the motion
        can have taken from the distances.
        """
        if x.shape != self.x.shape:
            self.lower = np.full((x.shape[0], scene.n_pairs), -np.inf)
        else:
            self.lower -= kinematics.largest_change(scene.reach, np.abs(x - self.x))
        self.x = x.copy()


@checked_dataclass(check=checked_constructor, kw_only=False, eq=False)
class CoalDistances:
    """Distances by coal, for any shapes; closed triangle meshes are solids, open ones surfaces.

    Pairs that were far at the last call with as many samples, and cannot have come near since, are
    not computed again. The pairs found do not depend on it; gradients do by about 1e-5, since coal
    starts from its last answer. Holds its own working memory, so not for two threads at once.
    """

    scene: CollisionScene
    _bounds: _Bounds = field(init=False, repr=False)
    _data: pin.Data = field(init=False, repr=False)
    _geometry_data: pin.GeometryData = field(init=False, repr=False)
    _signed: SignedDistances = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_data", self.scene.coordinates.robot.model.createData())
        object.__setattr__(self, "_geometry_data", distance_data(self.scene.geometry))
        object.__setattr__(self, "_signed", SignedDistances(self.scene.geometry))
        object.__setattr__(self, "_bounds", _Bounds(x=np.zeros((0, 0)), lower=np.zeros((0, 0))))

    def distances(self, x: Samples) -> Array:
        """Return (n, n_pairs) [m] signed distances at x (n, n_axes) [m, rad]; -inf for an overlap
        whose depth coal cannot tell.
        """
        return self.distances_at(self.scene.coordinates.configurations(x))

    def distances_at(self, q: Configurations, chosen: ChosenPairs | None = None) -> Array:
        """Compute signed distances (n, n_pairs) [m] at configurations q (n, n_q) [m, rad]; infinite
        for pairs that are not chosen (n, n_pairs), by default all are. Raises `InvalidInput` for
        what chooses by other than truth values.
        """
        result = np.full((len(q), self.scene.n_pairs), np.inf)
        data = self._geometry_data
        if chosen is None:
            selection = np.ones(result.shape, dtype=bool)
        elif chosen.dtype != np.bool_:
            raise InvalidInput(f"distances_at: chosen of {chosen.dtype}; give truth values")
        else:
            selection = chosen
        for row, configuration, selected in zip(result, q, selection, strict=True):
            pairs = np.flatnonzero(selected)
            self._place(configuration)
            row[pairs] = [self._signed.distance(data, k) for k in pairs.tolist()]
        result[result < FAILED] = -np.inf
        return result

    def contacts(self, q: Configurations) -> Contacts:
        """Find where all pairs are nearest at configurations q (n, n_q) [m, rad], without those
        whose depth coal cannot compute.
        """
        data = self._geometry_data
        n_pairs = self.scene.n_pairs
        contacts = np.empty((len(q), n_pairs, 10))
        for k, configuration in enumerate(q):
            self._place(configuration)
            for i in range(n_pairs):
                contact = self._signed.contact(data, i)
                contacts[k, i] = [
                    contact.distance,
                    *contact.normal,
                    *contact.first,
                    *contact.second,
                ]
        is_known = (contacts[..., 0] > FAILED) & np.isfinite(contacts).all(axis=-1)
        sample, pair = np.nonzero(is_known)
        rows = contacts[sample, pair]
        parts = {
            "distance": rows[:, 0],
            "normal": rows[:, 1:4],
            "first": rows[:, 4:7],
            "second": rows[:, 7:],
        }
        return Contacts(sample=sample, pair=pair, **parts)

    def near(
        self, x: Samples, thresholds: Annotated[Array, Shape("self.scene.n_pairs")]
    ) -> NearPairs:
        """Find the pairs closer than their thresholds (n_pairs,) [m] at x (n, n_axes) [m, rad].

        The derivative of a distance is ``n'(J_p2 - J_p1)`` with the normal n and the witness points
        p1, p2, which lie on one line along n: one wrench ``[n; p x n]`` at the origin serves both
        shapes, in penetration too.
        """
        near_contacts: list[_Contact] = []
        jacobians = np.zeros((x.shape[0], 6, self.scene.coordinates.robot.model.nvExtended))
        self._bounds.moved_to(x, self.scene)
        candidates = self._bounds.lower < thresholds
        configurations = self.scene.coordinates.configurations(x)
        limits = thresholds.tolist()
        for sample, chosen in _grouped(candidates):
            self._place(configurations[sample])
            self._collect(sample, chosen, limits, near_contacts)
            joint_jacobians = pin.computeJointJacobians(
                self.scene.coordinates.robot.model, self._data, configurations[sample]
            )
            # Pinocchio returns a vector for a single joint.
            jacobians[sample] = np.reshape(joint_jacobians, jacobians[sample].shape)
        if not near_contacts:
            return no_near_pairs(self.scene.fold)
        samples, pairs, distances, normals, points, centres = map(
            np.array, zip(*near_contacts, strict=True)
        )
        screws = (jacobians @ self.scene.coordinates.column_map(x))[samples]
        wrench = np.concatenate([normals, np.cross(points, normals)], axis=1)
        gradient = ((wrench[:, None, :] @ screws)[:, 0] * self.scene.moved[pairs]) @ self.scene.fold
        return NearPairs(
            sample=samples,
            pair=pairs,
            distance=distances,
            gradient=gradient,
            screws=screws,
            centre=centres,
        )

    def _place(self, q: Array) -> None:
        model = self.scene.coordinates.robot.model
        robot.require_normalized(model, q)
        pin.updateGeometryPlacements(model, self._data, self.scene.geometry, self._geometry_data, q)

    def _collect(
        self, sample: int, pairs: list[int], thresholds: list[float], near_contacts: list[_Contact]
    ) -> None:
        """Append the contacts of a sample's pairs that are closer than their thresholds, and note
        all distances.
        """
        data = self._geometry_data
        lower = self._bounds.lower[sample]
        for k in pairs:
            contact = self._signed.contact(data, k)
            distance = lower[k] = contact.distance
            if FAILED < distance < thresholds[k]:
                # A view of memory that the next sample overwrites.
                centre = data.oMg[self.scene.pairs[k].second].translation.copy()
                near_contacts.append(
                    (
                        sample,
                        k,
                        distance,
                        contact.normal,
                        contact.first,
                        centre,
                    )
                )


def _grouped(candidates: Mask) -> Iterator[tuple[int, list[int]]]:
    """Yield each sample that has candidates, with their pairs."""
    samples, pairs = np.nonzero(candidates)
    first = np.flatnonzero(np.diff(samples, prepend=-1))
    bounds = [*first.tolist(), samples.size]
    all_pairs = pairs.tolist()
    for sample, (start, end) in zip(samples[first].tolist(), pairwise(bounds), strict=True):
        yield sample, all_pairs[start:end]


def no_near_pairs(fold: Array) -> NearPairs:
    """Return `NearPairs` without any row; fold: (n_columns, n_axes), see `Coordinates.fold`."""
    none = np.zeros(0, dtype=np.intp)
    return NearPairs(
        sample=none,
        pair=none,
        distance=np.zeros(0),
        gradient=np.zeros((0, fold.shape[1])),
        screws=np.zeros((0, 6, len(fold))),
        centre=np.zeros((0, 3)),
    )
