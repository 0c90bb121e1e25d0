"""Words in names of links and joints that say what they are, without the prefix that all names
share.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

import pinocchio as pin

FIXED_ROOTS = ("world", "map", "odom", "ground")
"""Names of roots that do not move."""
_MIN_NAMES = 3  # of which the beginning that they share is a prefix
_LONG_WORD = 5  # letters above which a word counts in any part of a name
_PREFIX = re.compile(r".*[/_:.\-]")

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
    "propeller": _words(f"prop propeller thruster rotor blade screw fan {_FINS}"),
    "fin": _words(_FINS),
    "mount": _words("mount bracket holder clamp guard shroud housing"),
    "sensor": _words(_SENSORS),
    "finger": _words("finger jaw claw knuckle pincer thumb fingertip"),
    "tip": _words("tool tcp tip ee eef tool0 endeffector end_effector grasp effector"),
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

    def is_called(self, kind: str, *names: str) -> bool:
        """Check whether any of the names is one of a link or joint of this kind of `_PATTERNS`."""
        return any(_PATTERNS[kind].search(self.plain(name).lower()) for name in names)

    def plain(self, name: str) -> str:
        """Return a name without the prefix that all share."""
        for prefix in self._prefixes:
            if name.startswith(prefix):
                return name.removeprefix(prefix)
        return name


def _shared_prefix(names: Iterable[str]) -> str:
    """Return what all names begin with up to a separator, roots that do not move aside."""
    own_names = [name for name in names if name.lower() not in FIXED_ROOTS]
    if len(own_names) < _MIN_NAMES:
        return ""
    first = min(own_names)
    last = max(own_names)
    n_shared = 0
    while n_shared < len(first) and first[: n_shared + 1] == last[: n_shared + 1]:
        n_shared += 1
    prefix = _PREFIX.match(first[:n_shared])
    if prefix is None:
        return ""
    return prefix[0]
