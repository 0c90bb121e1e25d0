"""Every doubt that the package can raise about a recording: by what it says, with what it looks
for.
"""

from __future__ import annotations

import re
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Doubt:
    """A kind of doubt."""

    says: str
    """Pattern that its text alone has."""
    looks_for: str
    stated: bool = False
    """Whether a file, or the settings of a fit, state it themselves: nothing is guessed, and no
    rate is of interest.
    """


DOUBTS = (
    # Times.
    Doubt(
        "other clocks, or other units of times|too few to look at|no time is in all channels",
        "channels of different clocks",
    ),
    Doubt("times go back by up to", "a clock that was set back"),
    Doubt("samples had the time of another", "times of too few digits"),
    Doubt("two sensors\\?", "two sensors in one table"),
    Doubt("s between samples: the unit of its times", "times in another unit"),
    Doubt("arrives in bursts", "messages that were held up"),
    Doubt("gaps, the longest", "lost samples"),
    Doubt("nothing is recorded for", "silence of all channels"),
    Doubt("against the rate of the", "a channel that is late"),
    Doubt("differ at the end by another time than at the beginning", "a clock that jumps"),
    Doubt(
        "the vehicle accelerates .* what it says: a clock of its own", "commands of another clock"
    ),
    # Values of one channel.
    Doubt("nothing in it ever changes", "commands that stay"),
    Doubt("dead: .* stay within", "an axis that is dead"),
    Doubt("samples are exactly zero: lost ones", "zeros where nothing was measured"),
    Doubt("samples, all others", "rare numbers that stand for nothing"),
    Doubt(
        "jumps to .* and back",
        "numbers that stand for nothing, within the range of others or often",
    ),
    Doubt("and goes on from there", "a position that is set anew"),
    Doubt("is never beyond", "saturated sensors"),
    Doubt("for a tenth of the time: is it in", "values that no vehicle has: units, angles in deg"),
    Doubt("pulse widths in us", "pulse widths as thrust"),
    Doubt("shares of the largest command\\?", "shares as thrust"),
    Doubt("largest command are at most 1", "shares of another scale"),
    Doubt("never near 0: its offset", "thrust with an offset"),
    Doubt("of its numbers, all others within 1", "pulses that are none"),
    # Gravity.
    Doubt("in g, not in m/s2", "an accelerometer in g"),
    Doubt("gravity taken out", "an acceleration without gravity"),
    Doubt("and at rest it is .*: its units", "an accelerometer in other units"),
    Doubt("points down on average", "an accelerometer with z down"),
    Doubt("at rest it is along z: axes swapped", "axes of an accelerometer"),
    Doubt("the vehicle lies on its back", "an attitude with z down"),
    Doubt("held up against gravity downwards", "an attitude with z down in W"),
    Doubt(
        "with it what holds the vehicle up is",
        "an attitude along other axes than the accelerometer",
    ),
    Doubt(": a pressure in", "pressure as depth, by its size"),
    Doubt("begins as large as air in kPa", "pressure as depth, which metres may be"),
    Doubt("above a surface at 0: z down", "depth as height"),
    Doubt("above a surface at 0: a depth of the other sign", "a depth below 0", stated=True),
    Doubt("from where, or in which unit", "heights far above any water"),
    # Single columns.
    Doubt("times the way that the velocity says", "units of single columns of a position"),
    Doubt("alone up to", "units of single columns, by their size"),
    Doubt("moves against the velocity", "a height of the other sign"),
    Doubt("times as fast as the attitude: in deg/s", "units of single rates"),
    Doubt("in rad beside deg", "units of single angles"),
    Doubt("read as m, ", "pressure as depth, by its name", stated=True),
    Doubt("in a unit that nothing tells", "a pressure in no unit", stated=True),
    Doubt("its times are the column", "one time column in two units", stated=True),
    # How a sensor of velocity is mounted.
    Doubt("times the way that the position goes", "a scale of a velocity"),
    Doubt("how is it mounted", "a velocity of turned axes"),
    Doubt("beside the way of the position", "a heading that is turned a little"),
    Doubt("measured elsewhere than the position", "a lever arm"),
    # How a gyro is mounted.
    Doubt("times the rate at which the attitude turns", "a scale of a gyro"),
    Doubt("are not those of the attitude, but turned by", "a gyro of turned axes"),
    Doubt("while the attitude stands for what is right", "a bias of a gyro"),
    Doubt("turns otherwise than the angular_velocity at", "turns that are lost"),
    # Of what all channels are.
    Doubt("goes to and fro between two series", "two senders in one channel"),
    Doubt("is explained by the other; of another run", "channels of another motion"),
    Doubt("reads better with .*were it of roll, pitch and yaw", "another order of angles"),
    Doubt("too few digits, which make an error", "numbers of few digits"),
    # What stops, and what was not recorded.
    Doubt("stays exactly as it is from", "a sensor that stops"),
    Doubt("zero throughout, and the vehicle moves", "commands that were not recorded"),
    # Rates of poses, and axes.
    Doubt("it is level then, which it is not as it is", "order of a quaternion, by tilt"),
    Doubt(
        "reads better with .* it agrees with", "another way to read an attitude, by the velocities"
    ),
    Doubt("times the rate of the", "units of a velocity, or of a pose"),
    Doubt(
        "its axes fit the \\S+ of the \\S+ as", "axes and signs of a velocity or an accelerometer"
    ),
    Doubt("its axes fit the rate of the \\S+ in W", "a velocity in W"),
    Doubt("its rate fits the velocity with axes", "axes of W of a position"),
    Doubt("points elsewhere", "a heading that is turned"),
    Doubt("fit the acceleration as", "axes of a wrench"),
    Doubt("the vehicle accelerates as with", "thrusters exchanged or reversed"),
    Doubt("of what it is commanded, measured by the others", "thrusters dead or weak"),
    Doubt("its times are late, give delay", "commands logged late"),
    Doubt("of which lag and delay explain", "a delay of commands that is too short", stated=True),
    # Joints.
    Doubt("of them, and .* positions", "velocities of other joints than positions"),
    Doubt("stays where it is, and its velocity does not", "a position that is dead"),
    Doubt("stays as it is, and its position moves", "a velocity that is dead"),
    Doubt("fits .*the rate of position", "order and signs of joints"),
    # Columns and rows of a file.
    Doubt("rad: in deg", "angles in deg"),
    Doubt("degrees on the globe", "latitude and longitude as position"),
    Doubt("stands for more than one of its axes", "a column that is given twice"),
    Doubt("rows have NaN", "samples that are not there"),
    Doubt("as the file says, and taken for", "a unit in a header that is not known"),
    Doubt("breaks off", "a file that was cut"),
    # What a fit takes for something else.
    Doubt("that a fit takes for still water", "a current that is not learnt"),
    Doubt("than they can give: a fit takes it for given", "commands beyond limits"),
    Doubt("about its mean, and a fit takes it for steady", "a current that changes", stated=True),
    Doubt("not recorded: a fit along some axes", "commands that there are not", stated=True),
    Doubt("not recorded: means between poses", "a velocity that there is not", stated=True),
    Doubt("commands of a run of this toolkit act at once", "a delay that is held", stated=True),
    Doubt("thrusters were driven ahead of their lag", "a wrench in place of thrust", stated=True),
    Doubt(
        "not as it was asked of them",
        "thrust in place of commands, in records of runs",
        stated=True,
    ),
    Doubt("a fault of this run", "faults of a run", stated=True),
    Doubt("on the floor at", "contact with the floor in a run", stated=True),
)


def doubt_of(text: str) -> Doubt:
    """The one kind that a text is of. Raises LookupError for a text of none or of several."""
    doubts = [doubt for doubt in DOUBTS if re.search(doubt.says, text)]
    if len(doubts) != 1:
        patterns = [doubt.says for doubt in doubts]
        raise LookupError(f"{text!r} is listed as {patterns}; list it once in spoiled/doubts.py")
    return doubts[0]
