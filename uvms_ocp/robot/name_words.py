"""Words in names of links and joints that say what they are, without the prefix that all names
share, or most of one arm: ``light_arm/wrist`` is a wrist.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence

import pinocchio as pin

FIXED_ROOTS = ("world", "map", "odom", "ground")
"""Names of roots that do not move."""
_MIN_NAMES = 3  # of which the beginning that they share is a prefix
_ARM_JOINTS = 3
"""Joints in a row on the vehicle, from which the beginning that most of their names share is a prefix:
heads and thrusters that are pointed have less.
"""
_LONG_WORD = 5  # letters above which a word counts in any part of a name
_PARTS = re.compile(r"(?<=[/_:.\-])|(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")
"""Borders of words in a name: after a separator, and before a capital as in ``leftProp``."""

_COMPOUNDS = re.compile(
    r"(echo)[^a-z0-9]*(sounder)|(load)[^a-z0-9]*(cell)|(finger)[^a-z0-9]*(tip)|(end)[^a-z0-9]*(effector)"
)
"""Words that are one in another spelling, as in ``echoSounder``; a finger tip is no tip of an arm."""

_WORD = re.compile(r"[a-z]{3,}")  # shorter ones are places, such as ``fl``
_PLACE_WORDS = (
    "left right front rear back fore aft bow stern port starboard top bottom upper lower up down"
    " middle center centre vertical vert horizontal hor horiz lateral heave surge sway roll pitch"
    " yaw link joint"
)
_PLACES = frozenset(_PLACE_WORDS.split())
"""Words in names of parts that are alike, in other places."""

_FINS = "rudder fin flap wheel"
_SENSORS = (
    "cam camera sonar imu dvl gps usbl ins pressure depth altimeter sensor lidar laser echosounder"
    " mbes fls beacon antenna optical light lamp led hydrophone magnetometer acoustic modem ping"
    " inclinometer compass ctd gyro transducer pinger"
)


def _words(text: str) -> re.Pattern[str]:
    """Return a pattern of words that stand alone in a name, such as ``dvl`` in ``dvl_link``, or in
    any part of it where they are long.
    """
    words = text.split()
    short_words = "|".join(word for word in words if len(word) <= _LONG_WORD)
    long_words = "|".join(word for word in words if len(word) > _LONG_WORD)
    if not long_words:
        return re.compile(rf"(?<![a-z])({short_words})s?(?![a-z])")
    return re.compile(rf"(?<![a-z])({short_words})s?(?![a-z])|{long_words}")


_PATTERNS: Mapping[str, re.Pattern[str]] = {
    "propeller": _words(f"prop propeller thruster thr rotor blade screw fan {_FINS}"),
    "fin": _words(_FINS),
    "mount": _words("mount bracket holder clamp guard shroud housing"),
    "sensor": _words(_SENSORS),
    "arm": _words("arm manipulator gripper hand shoulder elbow wrist"),
    "finger": _words("finger jaw claw knuckle pincer thumb fingertip"),
    "load cell": _words("ft force torque wrench loadcell"),
    "tip": _words("tool tcp tip ee eef tool0 endeffector grasp effector"),
    "ballast": _words("ballast weight vbs trim mass battery"),
    "spinner": _words("blade cutter brush drill saw disc disk grinder rotor screw"),
    "altimeter": _words("altimeter echosounder dva"),
    "dvl": _words("dvl doppler"),
}
"""Words in names of links and joints, by what they are."""


class NameWords:
    """Words in the names of one mechanism."""

    def __init__(self, model: pin.Model) -> None:
        links = [str(frame.name) for frame in model.frames if frame.type == pin.FrameType.BODY]
        joint_types = (pin.FrameType.JOINT, pin.FrameType.FIXED_JOINT)
        joints = [str(frame.name) for frame in model.frames[2:] if frame.type in joint_types]
        prefixes = [_shared_prefix(links)]
        namespace = _shared_prefix(joints)
        if namespace.endswith("/"):
            prefixes.append(namespace)
        self._prefixes = tuple(prefixes)
        self._arm_prefixes = dict(_prefixes_of_arms(model))

    def is_called(self, kind: str, *names: str) -> bool:
        """Check whether any of the names is one of a link or joint of this kind of `_PATTERNS`."""
        return any(_PATTERNS[kind].search(self._lower(name)) for name in names)

    def is_on_arm_called(self, kind: str, name: str) -> bool:
        """Check whether the prefix that the names of its arm share says this kind of `_PATTERNS`."""
        beginning = self._without_prefix(name).removesuffix(self.plain(name))
        return bool(_PATTERNS[kind].search(_lower(beginning)))

    def alike(self, names: Sequence[str], *, besides: str) -> list[bool]:
        """Return of each name whether it is one of the most common kind; all are where no two are
        of a kind.

        Numbers, words for places and those of the kind `besides` of `_PATTERNS` make no difference.
        """
        stems = list[frozenset[str]]()
        for name in names:
            words = set(_WORD.findall(self._lower(name))) - _PLACES
            stems.append(frozenset(w for w in words if not _PATTERNS[besides].search(w)))
        if not stems:
            return []
        common, n_common = Counter(stems).most_common(1)[0]
        if n_common < 2:
            return [True] * len(names)
        return [stem == common for stem in stems]

    def _lower(self, name: str) -> str:
        """Return the words of a name without the prefix that all share, or most of its arm."""
        return _lower(self.plain(name))

    def plain(self, name: str) -> str:
        """Return a name without the prefix that all share, and without what it has of its arm's."""
        plain_name = self._without_prefix(name)
        arm_prefix = self._without_prefix(self._arm_prefixes.get(name, ""))
        parts = _PARTS.split(plain_name)
        n_shared = 0
        for part, arm_part in zip(parts[:-1], _PARTS.split(arm_prefix), strict=False):
            if part != arm_part:
                break
            n_shared += 1
        return "".join(parts[n_shared:])

    def _without_prefix(self, name: str) -> str:
        """Return a name without the prefix that all share."""
        for prefix in self._prefixes:
            if name.startswith(prefix):
                return name.removeprefix(prefix)
        return name


def _lower(name: str) -> str:
    """Return a name with its words in small letters and apart, compounds as one word."""
    words = "_".join(_PARTS.split(name)).lower()
    return _COMPOUNDS.sub(lambda match: "".join(filter(None, match.groups())), words)


def _prefixes_of_arms(model: pin.Model) -> Iterator[tuple[str, str]]:
    """Yield the names of links and joints that hang on long chains of joints, each with the prefix that
    most links, or most joints, of its chain share.
    """
    is_floating = model.njoints > 1 and model.joints[1].nv == 6
    vehicle_joint = 1 if is_floating else 0
    links_by_joint: dict[int, list[str]] = {joint: [] for joint in range(model.njoints)}
    for frame in model.frames:
        if frame.type == pin.FrameType.BODY:
            links_by_joint[frame.parentJoint].append(str(frame.name))
    for first in range(vehicle_joint + 1, model.njoints):
        if model.parents[first] != vehicle_joint:
            continue
        joints = [*model.subtrees[first]]
        last = max(joints, key=lambda joint: len(model.supports[joint]))
        chain = [joint for joint in model.supports[last] if joint > vehicle_joint]
        if len(chain) < _ARM_JOINTS:
            continue
        link_prefix = _usual_prefix([name for joint in chain for name in links_by_joint[joint][:1]])
        joint_prefix = _usual_prefix([str(model.names[joint]) for joint in chain])
        for joint in joints:
            yield str(model.names[joint]), joint_prefix
            yield from ((name, link_prefix) for name in links_by_joint[joint])


def _usual_prefix(names: Sequence[str]) -> str:
    """Return the longest beginning of whole words that more than half of the names share, and no less
    than `_MIN_NAMES`; each name keeps its last word.
    """
    n_by_beginning = Counter[str]()
    for name in names:
        beginning = ""
        for part in _PARTS.split(name)[:-1]:
            beginning += part
            n_by_beginning[beginning] += 1
    usual = ""
    for beginning, n_names in n_by_beginning.items():
        if n_names >= max(_MIN_NAMES, len(names) // 2 + 1) and len(beginning) > len(usual):
            usual = beginning
    return usual


def _shared_prefix(names: Iterable[str]) -> str:
    """Return the words that all names begin with, roots that do not move aside; each name keeps its
    last.
    """
    parts_by_name = [_PARTS.split(name) for name in names if name.lower() not in FIXED_ROOTS]
    if len(parts_by_name) < _MIN_NAMES:
        return ""
    shared = list[str]()
    for parts in zip(*(parts[:-1] for parts in parts_by_name), strict=False):
        if len(set(parts)) > 1:
            break
        shared.append(parts[0])
    return "".join(shared)
