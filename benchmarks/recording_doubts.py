"""What is found of recordings that were spoiled: ``python benchmarks/recording_doubts.py``.

Recordings of drawn vehicles are sound; of each, one thing after the other is spoiled by a drawn amount, and looked at as
`check-recording` and `identify` do. Writes recording_doubts.csv and recording_doubts.md.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from drawn_vehicles.driving import drawn, recorded, vehicle
from recording.report import Report, Row, Table, begin, parser_of

from uvms_ocp import load_robot, without_arm
from uvms_ocp.identification.calibration import mixed_thrusters
from uvms_ocp.identification.data_quality import check_data_quality
from uvms_ocp.identification.model import stage_of
from uvms_ocp.identification.recording import Channel, Recording, rotations
from uvms_ocp.robot.thrusters import thruster_matrix

ROBOTS, EACH, DURATION, SENT, HELD, THRUST = 25, 20, 60.0, 0.1, 2.0, 8.0
"""Sound recordings, spoiled ones of each, [s] of one, [s] between commands and between other ones, [N]."""
Spoiled = tuple[str, Recording]
"""Channel that is wrong, and the recording."""
PROSE = """
{sound} sound recordings of {duration:g} s of drawn vehicles, driven by random steps of thrust, and {n} spoiled ones. A spoiled
one is found where a doubt is about the channel that is wrong, or about the one that it is compared with, and the sound recording
has none like it. {found:.1f} % are found, {missed:.1f} % missed. Of the sound recordings {false:.1f} % raise a doubt, and
{others:.1f} % of the doubts about spoiled ones are about channels that are sound.
"""
_PARTNERS = {"linear_velocity": "position", "position": "linear_velocity", "attitude": "angular_velocity"}
_PARTNERS |= {"angular_velocity": "attitude", "thrust": "thrust"}
_MEASURED = ("position", "linear_velocity", "angular_velocity")


def sound(rng: np.random.Generator, robots: int) -> list[Recording]:
    """Recordings of drawn vehicles with all that a navigation system tells."""
    one = vehicle()
    stage, found = stage_of(one), []
    for k, truth in enumerate(drawn(one, rng, robots)):
        told = THRUST * rng.normal(size=(round(DURATION / HELD), len(one.actuators.names)))
        commands = Channel(t=np.arange(0.0, DURATION, SENT), values=np.repeat(told, round(HELD / SENT), axis=0))
        each = recorded(one, stage, truth, rng, commands, f"dive{k}")
        velocity, attitude = each.channels["linear_velocity"], each.channels["attitude"]
        in_world = np.einsum("nij,nj->ni", rotations(attitude, velocity.t), velocity.values)
        steps = np.diff(velocity.t)[:, None] * (in_world[1:] + in_world[:-1]) / 2
        place = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)]) + [0.0, 0.0, -20.0] + 0.01 * rng.normal(size=in_world.shape)
        found.append(replace(each, channels={**each.channels, "position": Channel(t=velocity.t, values=place)}))
    return found


def _with(one: Recording, name: str, change: Callable[[Channel], Channel]) -> Spoiled:
    return name, replace(one, channels={**one.channels, name: change(one.channels[name])})


def _values(one: Recording, name: str, change: Callable[[np.ndarray], np.ndarray]) -> Spoiled:
    return _with(one, name, lambda channel: replace(channel, values=change(channel.values)))


def unit(one: Recording, rng: np.random.Generator) -> Spoiled:
    """Millimetres, or degrees a second."""
    name = str(rng.choice(_MEASURED))
    return _values(one, name, lambda values: values * (np.rad2deg(1.0) if name == "angular_velocity" else 1e3))


def axis(one: Recording, rng: np.random.Generator) -> Spoiled:
    """Two axes of a velocity are exchanged."""
    order = np.delete(np.arange(3), k := int(rng.integers(3)))[::-1]
    return _values(one, str(rng.choice(_MEASURED[1:])), lambda values: values[:, np.insert(order, k, k)])


def sign(one: Recording, rng: np.random.Generator) -> Spoiled:
    """An axis of a velocity points the other way."""
    flipped = np.where(np.arange(3) == rng.integers(3), -1.0, 1.0)
    return _values(one, str(rng.choice(_MEASURED[1:])), lambda values: values * flipped)


def frame(one: Recording, rng: np.random.Generator) -> Spoiled:
    """Velocity in W, velocity with z down, or position with z down."""
    R, kind = rotations(one.channels["attitude"], one.channels["linear_velocity"].t), int(rng.integers(3))
    if kind == 0:
        return _values(one, "linear_velocity", lambda values: np.einsum("nij,nj->ni", R, values))
    return _values(one, ("linear_velocity", "position")[kind - 1], lambda values: values * [1.0, -1.0, -1.0])


def time(one: Recording, rng: np.random.Generator) -> Spoiled:
    """Times in ms, or a clock that jumps in the middle."""
    name, jump = str(rng.choice(_MEASURED)), rng.uniform(1.0, 5.0)
    if rng.uniform() < 0.5:
        return _with(one, name, lambda channel: replace(channel, t=1e3 * channel.t))
    return _with(one, name, lambda channel: replace(channel, t=channel.t + jump * (channel.t > DURATION / 2)))


def repeats(one: Recording, rng: np.random.Generator) -> Spoiled:
    """A sensor stops and says the same for a while."""
    name, begin, n = str(rng.choice(_MEASURED)), int(rng.integers(100, 300)), int(rng.integers(30, 200))
    return _values(one, name, lambda values: np.vstack([values[:begin], np.tile(values[begin], (n, 1)), values[begin + n :]]))


def sentinels(one: Recording, rng: np.random.Generator) -> Spoiled:
    """A value that stands for nothing."""
    name, value, share = str(rng.choice(_MEASURED[:2])), float(rng.choice([-32.768, -9999.0])), rng.uniform(0.005, 0.2)
    lost = rng.uniform(size=(len(one.channels[name].t), 1)) < share
    return _values(one, name, lambda values: np.where(lost, value, values))


def dead(one: Recording, rng: np.random.Generator) -> Spoiled:
    """One axis stays 0."""
    alive = np.arange(3) != rng.integers(3)
    return _values(one, str(rng.choice(_MEASURED[1:])), lambda values: values * alive)


def thrusters(one: Recording, rng: np.random.Generator) -> Spoiled:
    """Two thrusters are exchanged, or one is reversed."""
    i, j = rng.choice(one.channels["thrust"].values.shape[1], size=2, replace=False)
    order, signs = np.arange(one.channels["thrust"].values.shape[1]), np.ones(one.channels["thrust"].values.shape[1])
    if rng.uniform() < 0.5:
        order[[i, j]] = j, i
    else:
        signs[i] = -1.0
    return _values(one, "thrust", lambda values: values[:, order] * signs)


def delay(one: Recording, rng: np.random.Generator) -> Spoiled:
    """A velocity is late."""
    late = rng.uniform(0.3, 1.5)
    return _with(one, str(rng.choice(_MEASURED[1:])), lambda channel: replace(channel, t=channel.t + late))


def saturation(one: Recording, rng: np.random.Generator) -> Spoiled:
    """A sensor goes no farther than a part of what there is."""
    share = rng.uniform(0.3, 0.7)
    return _values(
        one,
        str(rng.choice(_MEASURED[1:])),
        lambda values: np.clip(values, *(share * np.abs(values).max(axis=0) * way for way in (-1.0, 1.0))),
    )


KINDS = (unit, axis, sign, frame, time, repeats, sentinels, dead, thrusters, delay, saturation)


def doubts(one: Recording, B: np.ndarray, names: Sequence[str]) -> set[tuple[str, str]]:
    """Channels with what is doubtful, without the numbers in it."""
    found = {(each.channel, "".join(c for c in each.problem if not c.isdigit())) for each in check_data_quality(one)}
    mixed = mixed_thrusters(one, one.channels["thrust"], B, names)
    return found | ({("thrust", mixed)} if mixed else set())


def main() -> None:
    """Spoil and look."""
    _, run = begin(parser_of(__doc__))
    robot, rng, rows = without_arm(load_robot("bluerov2_alpha5")), np.random.default_rng(0), list[Row]()
    B, names = thruster_matrix(robot), robot.thruster_names
    good, each, counter = sound(rng, 1 if run.quick else ROBOTS), len(KINDS) if run.quick else EACH, 0
    before = [doubts(one, B, names) for one in good]
    for known, one in zip(before, good, strict=True):
        for _ in range(each):
            kind = KINDS[counter % len(KINDS)]
            counter += 1
            channel, spoiled = kind(one, rng)
            new = doubts(spoiled, B, names) - known
            about = [text for name, text in new if name in (channel, _PARTNERS[channel])]
            rows.append({"recording": one.name, "spoiled": kind.__name__, "channel": channel, "found": bool(about),
                         "beside": len(new) - len(about), "doubts": len(new), "first": about[0] if about else ""})  # fmt: skip
    table = [
        {"spoiled": kind.__name__, "how": (kind.__doc__ or "").strip(), "n": len(own),
         "found [%]": 100.0 * float(np.mean([row["found"] for row in own])),
         "doubts beside it": float(np.mean([row["beside"] for row in own]))}
        for kind in KINDS if (own := [row for row in rows if row["spoiled"] == kind.__name__])
    ]  # fmt: skip
    found = 100.0 * float(np.mean([row["found"] for row in rows]))
    prose = PROSE.format(
        sound=len(good),
        duration=DURATION,
        n=len(rows),
        found=found,
        missed=100.0 - found,
        false=100.0 * float(np.mean([bool(one) for one in before])),
        others=100.0 * sum(row["beside"] for row in rows) / max(sum(row["doubts"] for row in rows), 1),
    )
    form = {"spoiled": "", "how": "", "n": "", "found [%]": ".0f", "doubts beside it": ".2f"}
    name, title = "recording_doubts", "Doubts about spoiled recordings"
    run.write(Report(name=name, title=title, prose=prose, tables=[Table(rows=table, columns=form)], data={name: rows}))


if __name__ == "__main__":
    main()
