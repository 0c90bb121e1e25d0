"""Figures: all that the record can fill, none that it cannot, and no trace in Matplotlib's global
state.
"""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.style import context
from synthetic_record import QUANTITIES, synthetic_record, without

from uvms_ocp.errors import InvalidInput, OutputError
from uvms_ocp.record.meta_values import FaultMeta, ThresholdMeta
from uvms_ocp.record.record import Record
from uvms_ocp.record.run_meta import RunMeta
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.viz.comparison_figures import figure_joint_comparison
from uvms_ocp.viz.effort_figures import figure_efforts
from uvms_ocp.viz.figure_names import PLAN_NAMES, RUN_NAMES
from uvms_ocp.viz.motion_figures import figure_joints, figure_velocities
from uvms_ocp.viz.plan_figures import PLAN_FIGURES
from uvms_ocp.viz.run_figures import FIGURES, write_figures
from uvms_ocp.viz.series import task_activity
from uvms_ocp.viz.style import DPI, png_of, save_figure
from uvms_ocp.viz.task_figures import (
    figure_activations,
    figure_altitude,
    figure_errors,
    figure_tool_error,
)
from uvms_ocp.viz.time_spans import phase_spans

_PNG = b"\x89PNG"


def _texts(figure: Figure) -> str:
    words = [
        text
        for axis in figure.axes
        for text in (axis.get_xlabel(), axis.get_ylabel(), axis.get_title())
    ]
    notes = [text.get_text() for axis in figure.axes for text in axis.texts]
    return "\n".join([*words, *notes])


def test_figures_have_the_names_that_are_known_beforehand() -> None:
    assert (tuple(FIGURES), tuple(PLAN_FIGURES)) == (RUN_NAMES, PLAN_NAMES)


def test_every_figure_of_a_complete_record_is_written_as_png(
    record: Record, tmp_path: Path
) -> None:
    paths = write_figures(record, tmp_path / "figures")
    assert [path.stem for path in paths] == list(FIGURES)
    assert all(path.read_bytes().startswith(_PNG) for path in paths)


@pytest.mark.slow
def test_a_figure_is_written_as_matplotlib_itself_writes_it(record: Record, tmp_path: Path) -> None:
    first = figure_joints(record)
    second = figure_joints(record)
    assert first is not None
    assert second is not None
    first.savefig(tmp_path / "own.png", dpi=DPI)
    save_figure(second, tmp_path / "ours.png")
    own_picture, our_picture = (imread(tmp_path / name) for name in ("own.png", "ours.png"))
    np.testing.assert_array_equal(our_picture, own_picture)
    assert second.get_layout_engine() is not None


@pytest.mark.slow
def test_labels_of_ticks_can_be_read(record: Record) -> None:
    drawn = [figure for draw in FIGURES.values() if (figure := draw(record)) is not None]
    for figure in drawn:
        figure.set_dpi(30)
        figure.canvas.draw()
    labels = {
        label.get_text()
        for figure in drawn
        for axis in figure.axes
        for label in axis.get_yticklabels(which="both")
    }
    assert "10⁻²" in labels
    assert not [label for label in labels if set(label) & set("$\\{}^")]


def test_figures_whose_quantities_are_missing_are_left_out(record: Record) -> None:
    poor = replace(record, meta=record.meta.model_copy(update={"quantities": ()}))
    assert figure_errors(poor) is None
    assert figure_altitude(poor) is None
    assert figure_velocities(poor) is not None


def test_a_record_with_nothing_but_time_and_motion_still_gives_figures(
    record: Record, tmp_path: Path
) -> None:
    series = {name: record[name] for name in ("t", "q", "v")}
    told = (
        "scenario",
        "robot",
        "joints",
        "phases",
        "plant",
        "solver",
        "floating",
        "dt",
        "completed",
    )
    bare = Record(
        series=series, meta=RunMeta(**{name: getattr(record.meta, name) for name in told})
    )
    assert {path.stem for path in write_figures(bare, tmp_path)} == {"velocities", "joints", "path"}


def test_a_robot_without_a_free_vehicle_has_no_vehicle_figures() -> None:
    fixed = synthetic_record(load_robot("planar5"))
    drawn = {name for name, draw in FIGURES.items() if draw(fixed) is not None}
    assert "joints" in drawn
    assert not drawn & {"velocities", "path"}


@pytest.mark.parametrize("name", list(FIGURES))
def test_every_panel_has_units_or_a_task_and_every_phase_is_named(
    record: Record, name: str
) -> None:
    figure = FIGURES[name](record)
    assert figure is not None
    labels = [axis.get_xlabel() for axis in figure.axes]
    assert any("[" in label for label in labels)
    named = _texts(figure) + "".join(
        text.get_text() for legend in figure.legends for text in legend.texts
    )
    assert "A way point" in named
    assert "B tool frame" in named


@pytest.mark.slow
@pytest.mark.parametrize(
    "rows", [slice(None), slice(0, 20), slice(-20, None)], ids=["all", "first", "last"]
)
@pytest.mark.parametrize("names", [("LA.altitude",), QUANTITIES], ids=["altitude", "everything"])
def test_every_figure_bears_quantities_that_are_not_known(
    record: Record, names: tuple[str, ...], rows: slice, tmp_path: Path
) -> None:
    written = {path.stem for path in write_figures(without(record, *names, rows=rows), tmp_path)}
    assert written == set(FIGURES) - ({"altitude"} if rows == slice(None) else set())


def test_thresholds_of_the_mission_are_drawn_with_their_value(record: Record) -> None:
    figure = figure_altitude(record)
    assert figure is not None
    assert "0.17 m" in _texts(figure)


def test_a_view_near_the_floor_is_drawn_where_the_vehicle_comes_near(record: Record) -> None:
    def panels(height: float) -> int:
        quantities = record["quantities"].copy()
        column = record.meta.quantities.index("LA.altitude")
        quantities[:, column] = np.linspace(5.0 + height, 5.0, len(record))
        figure = figure_altitude(
            replace(record, series={**record.series, "quantities": quantities})
        )
        assert figure is not None
        return len(figure.axes)

    assert panels(100.0) == panels(1.0) + 1


def test_one_panel_per_task_in_order_of_priority(record: Record) -> None:
    figure = figure_activations(record)
    assert figure is not None
    assert [axis.get_ylabel() for axis in figure.axes] == ["PC", "T", "HA"]


def test_rows_of_a_task_are_cut_out_of_the_stacked_activity(record: Record) -> None:
    rows = task_activity(record, "T")
    assert rows is not None
    np.testing.assert_array_equal(rows[:, 0], record["activity"][:, -1])


def test_phases_cover_the_record_without_gaps(record: Record) -> None:
    spans = phase_spans(record)
    assert [span.name for span in spans] == ["A", "B"]
    assert spans[0].start == record["t"][0]
    assert spans[0].end == spans[1].start
    assert spans[1].end == record["t"][-1]


def test_a_phase_that_comes_back_has_two_spans(record: Record) -> None:
    phase = np.zeros(len(record), dtype=int)
    phase[40:80] = 1
    again = Record(series={**record.series, "phase": phase}, meta=record.meta)
    assert [span.name for span in phase_spans(again)] == ["A", "B", "A"]


def test_figures_show_themselves_in_notebooks(record: Record) -> None:
    figure = figure_velocities(record)
    assert figure is not None
    assert figure._repr_png_().startswith(_PNG)


def test_drawing_leaves_the_settings_of_matplotlib_alone(record: Record) -> None:
    before = dict(mpl.rcParams)
    figure_velocities(record)
    assert dict(mpl.rcParams) == before


@pytest.mark.slow
@pytest.mark.parametrize(
    "own",
    [
        "dark_background",
        "seaborn-v0_8-darkgrid",
        {"font.size": 20, "axes.labelcolor": "white", "savefig.dpi": 9},
    ],
)
def test_no_style_of_the_caller_changes_a_figure(
    record: Record, own: str | dict[str, object]
) -> None:
    """White words on white paper were the end of figures in notebooks with a dark style."""

    def pictures() -> list[bytes]:
        drawn = [FIGURES[name](record) for name in ("joints", "velocities")]
        return [png_of(figure, 60) for figure in drawn if figure is not None]

    as_ever = pictures()
    with context(own):
        assert pictures() == as_ever
    assert len(as_ever) == 2


def test_pyplot_is_never_imported() -> None:
    code = "import sys, uvms_ocp.viz; sys.exit('matplotlib.pyplot' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_record_without_motion_says_so(robot: Robot, tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="1 rows; at least 2"):
        write_figures(synthetic_record(robot, duration=0.0), tmp_path)


@pytest.mark.parametrize("name", FIGURES)
def test_every_figure_of_one_row_says_so(name: str, robot: Robot) -> None:
    with pytest.raises(InvalidInput, match="1 rows; at least 2"):
        FIGURES[name](synthetic_record(robot, duration=0.0))


def test_an_altitude_without_any_echo_is_not_drawn(record: Record) -> None:
    for unknown in (np.nan, np.inf):
        quantities = record["quantities"].copy()
        quantities[:, record.meta.quantities.index("LA.altitude")] = unknown
        assert (
            figure_altitude(replace(record, series={**record.series, "quantities": quantities}))
            is None
        )


def test_an_altitude_with_some_echoes_is_drawn(record: Record) -> None:
    quantities = record["quantities"].copy()
    quantities[::2, record.meta.quantities.index("LA.altitude")] = np.inf
    assert (
        figure_altitude(replace(record, series={**record.series, "quantities": quantities}))
        is not None
    )


def test_joints_of_another_robot_are_not_compared(record: Record) -> None:
    renamed_record = replace(
        record, meta=record.meta.model_copy(update={"joints": tuple("abcdefg")})
    )
    for records in ({"one": record, "two": renamed_record}, {}):
        with pytest.raises(
            InvalidInput,
            match=f"records = {len(records)} runs; give one or more with the same joints",
        ):
            figure_joint_comparison(records)


def test_a_joint_of_several_axes_has_its_torques_by_number(record: Record) -> None:
    joints = record.meta.joints[:-1]
    figure = figure_efforts(replace(record, meta=record.meta.model_copy(update={"joints": joints})))
    assert figure is not None
    assert [text.get_text() for text in figure.axes[1].get_legend().get_texts()] == list("1234567")


def test_errors_of_several_tools_are_drawn_by_their_names(record: Record) -> None:
    tools = {"T": "left_hand", "PC": "right_hand"}
    tasks = tuple(
        task.model_copy(update={"tool": tools.get(task.name)}) for task in record.meta.tasks
    )
    two_tools = figure_tool_error(
        replace(record, meta=record.meta.model_copy(update={"tasks": tasks}))
    )
    assert two_tools is not None
    labels = [axis.get_ylabel() for axis in two_tools.axes]
    for name in tools.values():
        assert any(label.startswith(f"{name}\nposition error [m]") for label in labels)
    alone = figure_tool_error(record)
    assert alone is not None
    assert len(alone.axes) < len(labels)


def test_every_thruster_has_a_line_of_its_own_in_the_legend(record: Record) -> None:
    figure = figure_efforts(record)
    assert figure is not None
    lines = figure.axes[0].get_lines()
    n = record["thrust"].shape[1]
    named = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    assert named == [f"t{i + 1}" for i in range(n)]
    assert len({(line.get_color(), line.get_linestyle()) for line in lines[:n]}) == n


def test_a_line_at_a_threshold_says_which_phase_waits_for_it_and_which_is_the_abort(
    record: Record,
) -> None:
    limits = {"A": 0.1, "climb": 0.3}
    waits = tuple(
        ThresholdMeta(quantity="PC.position_error", limit=x, sign="<", phase=p)
        for p, x in limits.items()
    )
    phases = (*record.meta.phases, record.meta.phases[0].model_copy(update={"name": "climb"}))
    changed = {"thresholds": waits, "abort_phase": "climb", "phases": phases}
    figure = figure_errors(replace(record, meta=record.meta.model_copy(update=changed)))
    assert figure is not None
    texts = [text.get_text() for text in figure.axes[0].texts]
    assert {"threshold 0.1, phase A", "threshold 0.3, abort"} <= set(texts)


def test_a_folder_that_is_a_file_is_an_output_error(record: Record, tmp_path: Path) -> None:
    place = tmp_path / "taken"
    place.write_text("")
    with pytest.raises(OutputError, match="taken"):
        write_figures(record, place)


@pytest.mark.slow
def test_every_panel_over_time_marks_where_something_went_wrong() -> None:
    faults = (
        FaultMeta(text="altimeter_range:frozen@2", target="altimeter_range", kind="frozen", t=2.0),
        FaultMeta(text="thruster3:dead@3-4", target="thruster3", kind="dead", t=3.0, end=4.0),
    )
    sound, struck = (
        synthetic_record(load_robot("girona_maris7"), faults=injected) for injected in ((), faults)
    )
    for draw in (
        figure_errors,
        figure_activations,
        figure_joints,
        figure_efforts,
        figure_velocities,
    ):
        plain = draw(sound)
        marked = draw(struck)
        assert plain is not None
        assert marked is not None
        for before, after in zip(plain.axes, marked.axes, strict=True):
            assert len(after.lines) - len(before.lines) == 3
            assert {2.0, 3.0, 4.0} <= {
                float(line.get_xdata()[0]) for line in after.lines if len(line.get_xdata()) == 2
            }
        texts = [text.get_text() for axis in marked.axes for text in axis.texts]
        assert {"altimeter_range:frozen", "thruster3:dead"} <= set(texts)
