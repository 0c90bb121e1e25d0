"""One right call of every public callable. Most arguments come from a pool, by the annotation of
their parameter or its name; `ARGUMENTS` holds what a callable needs beyond that. What is expensive
is small here: short runs, few steps.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Mapping
from functools import cache
from inspect import Parameter
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import casadi as ca
import coal
import numpy as np
import pinocchio as pin
from compiler import MISSING
from public_surface import Call

from uvms_ocp import (
    control,
    mission,
    ocp,
    planning,
    planning as collision,
    report,
    sim,
    solvers,
    tasks,
    trajectories,
    without_arm,
)
from uvms_ocp.campaign import Campaign, Choice, LogNormal, Normal, Triangular, Uniform
from uvms_ocp.campaign.jobs import attempt_job
from uvms_ocp.campaign.store import opened
from uvms_ocp.codegen.buffered import BufferedFunction
from uvms_ocp.control.plan_following import PlannedPhase
from uvms_ocp.control.velocity import levels
from uvms_ocp.control.velocity.abort import ActuationFeedback
from uvms_ocp.control.velocity.tick_state import TickInputs
from uvms_ocp.estimation.fallbacks import Freshness, Watchdog
from uvms_ocp.mission_plan import Margins, MissionPlan
from uvms_ocp.mission_plan.mission_digests import mission_digests
from uvms_ocp.ocp.trajectory import Trajectory
from uvms_ocp.ocp.transcription.transcription import Transcription
from uvms_ocp.planning.conservative_advancement import ClearanceReport
from uvms_ocp.record.meta_values import ObstacleMeta
from uvms_ocp.record.record import Record
from uvms_ocp.robot.dynamics import Dynamics, robot_dynamics
from uvms_ocp.robot.kinematics import Kinematics
from uvms_ocp.robot.loading import load_robot, robot_folder
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.shapes.collision_model import CollisionModel
from uvms_ocp.robot.signals import (
    IDEAL_SENSORS,
    Command,
    Readings,
    SensorSpec,
    State,
    StateEstimate,
    Trust,
)
from uvms_ocp.robot.symbolic_model import SymbolicModel
from uvms_ocp.scenario import estimate_recording, replay
from uvms_ocp.scenario.cases import RunOptions, case1, reach
from uvms_ocp.scenario.preflight import Finding, PreflightReport, Severity
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.sim import Fault
from uvms_ocp.solvers import nlp, stage_qp as stagewise
from uvms_ocp.solvers.nlp.program import row_bounds
from uvms_ocp.tasks.task import TickSymbols
from uvms_ocp.viz.scene.page import ScenePage

RECORDS = Path(__file__).parents[1] / "records"
Arguments = Mapping[str, Any]
_MODULE = re.compile(r"\b[a-z_]+\.(?=[A-Z])")  # of a name in an annotation
STARRED = (Parameter.VAR_POSITIONAL, Parameter.VAR_KEYWORD)


def right_arguments(call: Call) -> dict[str, Any]:
    """Of one right call: what has no default, and what `ARGUMENTS` gives."""
    arguments = dict(ARGUMENTS.get(call.title, dict)())
    for name, parameter in call.parameters.items():
        is_required = parameter.default is parameter.empty and parameter.kind not in STARRED
        if is_required and name not in arguments:
            arguments[name] = from_pool(str(parameter.annotation), name)
    return arguments


def from_pool(annotation: str, name: str) -> Any:
    """A right value for a parameter. Raises `KeyError` where there is none."""
    annotation = annotation if annotation in POOL else _MODULE.sub("", annotation)
    named = name in NAMED and (annotation == "str" or annotation not in POOL)
    return NAMED[name]() if named else POOL[annotation]()


def owner_of(call: Call) -> Any:
    """The value on which a method is called."""
    assert call.owner is not None
    return POOL[call.owner.__name__]()


@cache
def scenario() -> Scenario:
    return case1(plant="kinematic", duration=0.01)


def robot() -> Robot:
    return scenario().robot


def q() -> np.ndarray:
    return scenario().start.copy()


@cache
def curve_record() -> Record:
    return Record.load(RECORDS / "plan_curve_v0_1.npz")


@cache
def run_record() -> Record:
    return Record.load(RECORDS / "run_v0_1.npz")


@cache
def noisy_run() -> Record:
    return reach(noise=True, duration=0.05).run()


@cache
def arm() -> Robot:
    return load_robot("planar5")


@cache
def dynamics() -> Dynamics:
    return robot_dynamics(robot())


@cache
def symbolic() -> SymbolicModel:
    return SymbolicModel(robot().model)


@cache
def tick_symbols() -> TickSymbols:
    return levels.tick_symbols(robot(), 0.005)


@cache
def stage_symbols() -> Any:
    from uvms_ocp.ocp.terms import StageSymbols

    n_u = len(robot().description.thrusters)
    thrust = ca.SX.sym("f", n_u)
    torque = ca.SX.sym("tau", robot().n_joints)
    a = ca.SX.sym("a", robot().n_v)
    return StageSymbols(
        tick=tick_symbols(),
        acceleration=a,
        thrust=thrust,
        thrust_share=thrust,
        torque=torque,
        torque_share=torque,
    )


@cache
def scene() -> collision.CollisionScene:
    return collision.collision_scene(collision.coordinates(robot()), [rock()])


@cache
def curve() -> trajectories.PiecewisePolynomial:
    return trajectories.min_snap(
        np.array([[0.0, 0.0], [1.0, 0.5], [2.0, 0.0]]), [0.0, 1.0, 2.0]
    ).trajectory


@cache
def motion() -> trajectories.PiecewisePolynomial:
    x = scene().coordinates.x(q())
    return trajectories.min_snap(np.array([x, x + 0.01, x]), [0.0, 1.0, 2.0]).trajectory


@cache
def problem() -> ocp.OcpProblem:
    task = tasks.ToolPosition(goal=pin.SE3.Identity(), frame=arm().model.frames[-1].name)
    level = ocp.OcpLevel(name="tool", terms=(ocp.TaskTerm(task=task), ocp.Smoothness()))
    start = State(q=arm().configuration(), v=np.zeros(arm().n_v))
    return ocp.single_phase(robot=arm(), start=start, duration=1.0, n_steps=2, levels=[level])


@cache
def plan() -> ocp.Plan:
    return ocp.plan(problem())


@cache
def ocp_result() -> ocp.OcpResult:
    goal = planning.PostureGoal(joints={arm().joints[0].name: 0.1})
    request = ocp.OcpRequest(
        robot=arm(), start=arm().configuration(), goal=goal, n_steps=2, duration=1.0
    )
    return ocp.OcpResult(
        request=request,
        scene=collision.collision_scene(collision.coordinates(arm()), []),
        plan=plan(),
    )


@cache
def small_program() -> nlp.LexicographicProgram:
    x = ca.SX.sym("x", 2)
    return nlp.lexicographic_program(
        x, [nlp.NlpLevel(y=x - 0.8)], g=ca.sum1(x), g_lower=-1.0, g_upper=1.0
    )


@cache
def path_plan() -> planning.CollisionPlan:
    from uvms_ocp.planning.path_cost import CostParts
    from uvms_ocp.planning.scene import NearestPair

    nearest = NearestPair(distance=1.0, time=0.0, pair=scene().pairs[0].name)
    report = ClearanceReport(collision_free=True, undecided=False, nearest=nearest, n_samples=3)
    return planning.CollisionPlan(
        trajectory=motion(),
        status=next(iter(planning.PlanStatus)),
        clearance=report,
        cost=CostParts(1.0, 1.0, 1.0),
        iterations=1,
        attempts=1,
        solve_time=0.1,
    )


def path_request() -> planning.PlanRequest:
    return planning.PlanRequest(robot=robot(), start=q(), goal=tool())


def path_result() -> planning.PlanResult:
    return planning.PlanResult(request=path_request(), scene=scene(), plan=path_plan())


def rock() -> collision.Obstacle:
    return collision.obstacle("rock", coal.Sphere(0.3), [30.0, 0.0, -3.0])


def tool() -> planning.ToolGoal:
    return planning.ToolGoal(position=(12.3, 37.0, -38.5))


def data() -> ObstacleMeta:
    return ObstacleMeta(name="rock", shape="sphere", size=(0.3,), position=(0.0, 0.0, 0.0))


def state_estimate() -> StateEstimate:
    return StateEstimate(q=q(), v=np.zeros(robot().n_v), altimeter_range=3.0)


def state() -> State:
    return State(q=q(), v=np.zeros(robot().n_v))


def readings() -> Readings:
    return suite().read(state(), 0.0)


def suite() -> sim.SensorSuite:
    return sim.SensorSuite(robot(), sim.FlatSeafloor(z=-60.0), IDEAL_SENSORS)


def fault() -> Fault:
    return Fault(target="altimeter", kind="frozen", onset=8.0)


def phase() -> mission.Phase:
    return mission.Phase(name="A", activations={"HA": 1.0}, transitions=(transition(),))


def abort() -> mission.Abort:
    return mission.Abort(phase=climb())


def climb() -> mission.Phase:
    return dataclasses.replace(
        phase(),
        activations={"PC": 1.0},
        transitions=(mission.Transition(to="abort", when=(below(),)),),
    )


def below() -> mission.Below:
    return mission.Below(quantity="HA.tilt", limit=0.1)


def transition() -> mission.Transition:
    return mission.Transition(to="done", when=(below(),))


@cache
def controller() -> control.KinematicController:
    return scenario().kinematic_controller()


@cache
def dynamic_controller() -> control.DynamicController:
    return control.DynamicController(
        robot=robot(), dynamics=dynamics(), kinematic=scenario().kinematic_controller()
    )


def tick() -> TickInputs:
    state = controller().mission.start()
    activations = controller().mission.activations(state, 0.0)
    return TickInputs(
        begin=0.0,
        t=0.0,
        estimate=state_estimate(),
        echo=3.0,
        altitude_valid=True,
        mission=state,
        gates=activations,
        freshness=Freshness.FRESH,
    )


def level() -> solvers.Level:
    return solvers.Level(jacobian=np.eye(2), lower=0.0, upper=1.0)


def quantities() -> dict[str, float]:
    return dict.fromkeys((*controller().problem.quantity_names, "HA.tilt"), 0.05)


@cache
def levels_function() -> ca.Function:
    return controller().problem.function


def poses() -> Any:
    return symbolic().local_poses(ca.SX.sym("q", robot().model.nq))


@cache
def clearance() -> tasks.Clearance:
    return tasks.Clearance(model=CollisionModel(robot(), [rock()]))


@cache
def nmpc() -> control.Nmpc:
    return control.Nmpc(problem())


def fields_of(value: Any) -> dict[str, Any]:
    """The arguments that make a value anew."""
    return {item.name: getattr(value, item.name) for item in dataclasses.fields(value) if item.init}


def parameters(n: int) -> dict[str, Any]:
    return {"parameters": ca.SX.sym("p", n)}


def sx(name: str) -> ca.SX:
    return ca.SX.sym(name, robot().model.nq)


def full_command() -> Command:
    n_u = len(robot().description.thrusters)
    return Command(v=np.zeros(robot().n_v), thrust=np.zeros(n_u), torque=np.zeros(robot().n_joints))


def wrenches() -> Any:
    from uvms_ocp.robot.symbolic_bodies import Wrench

    return [Wrench(force=ca.SX.zeros(3), moment=ca.SX.zeros(3)) for _ in poses()]


@cache
def whole() -> MissionPlan:
    """As if somebody had planned the mission of `scenario`, and it were of no length."""
    q0 = np.array(scenario().start)
    n_v = robot().n_v
    steady = Trajectory(
        t=np.array([0.0, 1.0]),
        q=np.array([q0, q0]),
        v=np.zeros((2, n_v)),
        a=np.zeros((1, n_v)),
        thrust=np.zeros((1, len(robot().description.thrusters))),
        torque=np.zeros((1, robot().n_joints)),
    )
    return MissionPlan(
        scenario=scenario().name,
        trajectory=steady,
        phases=(PlannedPhase(phase=0, begin=0.0, end=1.0, moves=False),),
        names=("A",),
        status=ocp.OcpStatus.SOLVED,
        reason="all goals are met",
        energy=1.0,
        clearance=0.1,
        greedy_duration=2.0,
        iterations=3,
        solve_time=0.1,
        identity=mission_digests(scenario()),
    )


@cache
def planner() -> ocp.Planner:
    return ocp.Planner(problem())


@cache
def dynamic_plant() -> sim.DynamicPlant:
    return sim.DynamicPlant(robot(), q(), dynamics=dynamics(), environment=scenario().environment)


@cache
def sqp() -> nlp.RealTimeSqp:
    return nlp.RealTimeSqp(Transcription(problem()).program)


@cache
def stage_shape() -> stagewise.StageShape:
    return stagewise.StageShape(n_x=(2, 2), n_u=(1,), n_r=(0, 1), n_c=(1, 0))


def stage_solver() -> stagewise.StageQpSolver:
    return stagewise.StageQpSolver(stage_shape(), stagewise.StageQpOptions(compiled=False))


def nmpc_x() -> int:
    return int(Transcription(problem()).n_x)


def nmpc_p() -> np.ndarray:
    return Transcription(problem()).parameters(problem())


def arm_estimate() -> StateEstimate:
    return StateEstimate(q=arm().configuration(), v=np.zeros(arm().n_v), altimeter_range=np.nan)


def two_postures() -> np.ndarray:
    x = scene().coordinates.x(q())
    return np.array([x, x + 0.01])


def limits() -> trajectories.MotionLimits:
    return trajectories.MotionLimits(
        velocity=robot().limits.velocity, acceleration=robot().limits.acceleration
    )


def simulation() -> dict[str, Any]:
    return {
        "plant": sim.KinematicPlant(robot(), q()),
        "sensors": suite().read,
        "estimator": control.PassThrough(robot()),
        "controller": controller(),
        "dt": 0.005,
        "duration": 0.01,
    }


def lexicographic() -> dict[str, Any]:
    x = ca.SX.sym("x", 2)
    return {"x": x, "levels": [nlp.NlpLevel(y=x)]}


def _curve_file() -> str:
    curve().to_numpy("curve.npz")
    return "curve.npz"


def _survey_file() -> str:
    path = Path(mkdtemp(), "survey.csv")
    path.write_text("0,0,-9\n1,0,-9\n0,1,-9\n1,1,-9\n", encoding="utf-8")
    return str(path)


def _obstacle_file() -> str:
    text = "obstacles: [{name: ball, shape: sphere, size: [0.3], position: [1.0, 0.0, 0.0]}]"
    Path("obstacles.yaml").write_text(text, encoding="utf-8")
    return "obstacles.yaml"


def keyed(task: type[tasks.Task], **fields: Any) -> Callable[[], tasks.Task]:
    return lambda: task(**fields)


NAMED: dict[str, Callable[[], Any]] = {
    "frame": lambda: "tool",
    "sizes": lambda: controller().problem.sizes,
    "p_W": lambda: np.zeros((2, 3)),
    "q": q,
    "q0": q,
    "v": lambda: np.zeros(robot().n_v),
    "a": lambda: np.zeros(robot().n_v),
    "tau": lambda: np.zeros(robot().n_v),
    "folder": lambda: "figures",
    "path": lambda: "file",
    "plant": lambda: "kinematic",
    "origin": lambda: np.array([0.0, 0.0, 50.0]),
    "direction": lambda: np.array([0.0, 0.0, -1.0]),
    "position": lambda: (0.0, 0.0, -3.0),
    "velocity": lambda: [0.1, 0.0, 0.0],
    "waypoints": lambda: np.array([[0.0, 0.0], [1.0, 0.5], [2.0, 0.0]]),
    "times": lambda: [0.0, 1.0, 2.0],
    "start": q,
    "x": lambda: scene().coordinates.x(q())[None],
    "indices": lambda: [0],
    "axes": lambda: (1,),
    "names": lambda: ("a",),
    "known": lambda: tuple(quantities()),
    "activations": lambda: np.ones(len(scenario().mission.hierarchy.tasks)),
    "gates": lambda: np.ones(len(scenario().mission.hierarchy.tasks)),
    "bounds": lambda: (0.0, 1.0),
}
"""Right values by the name of a parameter."""

POOL: dict[str, Callable[[], Any]] = {
    "Campaign": lambda: _campaign(),
    "Choice": lambda: Choice((1.0, 2.0)),
    "LogNormal": LogNormal,
    "Normal": lambda: Normal(0.0, 1.0),
    "Triangular": lambda: Triangular(0.0, 0.5, 1.0),
    "Uniform": lambda: Uniform(0.0, 1.0),
    "str": lambda: "HA",
    "float": lambda: 1.0,
    "Magnitude": lambda: 0.1,
    "Finite": lambda: 1.0,
    "Positive": lambda: 1.0,
    "Period": lambda: 1.0,
    "Count": lambda: 1,
    "int": lambda: 1,
    "bool": lambda: True,
    "Path": lambda: Path("file"),
    "Robot": robot,
    "Mission": lambda: scenario().mission,
    "Environment": lambda: scenario().environment,
    "Scenario": scenario,
    "Scenario | Robot": scenario,
    "Record": run_record,
    "Mapping[str, Record]": lambda: {"a": run_record(), "b": run_record()},
    "RunMeta | PlanMeta": lambda: run_record().meta,
    "Mapping[str, np.ndarray]": lambda: {"t": np.arange(3.0)},
    "Dynamics": dynamics,
    "SymbolicModel": symbolic,
    "TickSymbols": tick_symbols,
    "StageSymbols": stage_symbols,
    "CollisionScene": scene,
    "Coordinates": lambda: scene().coordinates,
    "CoalDistances": lambda: collision.CoalDistances(scene()),
    "PairDistances": lambda: collision.CoalDistances(scene()),
    "PiecewisePolynomial": curve,
    "Sequence[PiecewisePolynomial]": lambda: [curve(), curve()],
    "MotionLimits": lambda: trajectories.MotionLimits(velocity=1.0, acceleration=1.0),
    "OcpProblem": problem,
    "OcpRequest": lambda: ocp_result().request,
    "OcpResult": ocp_result,
    "Plan": plan,
    "MissionPlan": whole,
    "Margins": Margins,
    "tuple[PlannedPhase, ...]": lambda: whole().phases,
    "Guide": lambda: whole().guide(scenario()),
    "Trajectory": lambda: plan().trajectory,
    "Planner": planner,
    "Record | Plan": curve_record,
    "Plan | Record": plan,
    "Plan | Record | Runs": plan,
    "Where": lambda: sim.KinematicPlant(arm(), arm().configuration()),
    "ReplayResult": lambda: replay(plan(), from_pool("Where", "where")),
    "tuple[Mapping[str, Any], ...]": lambda: ({"channel": "depth"},),
    "RecordedEstimate": lambda: estimate_recording(noisy_run(), reach().robot),
    "TrackingError": lambda: from_pool("ReplayResult", "flight").mismatch,
    "OwnRows": lambda: lambda stage: stage.tick.q[0],
    "Transcription": lambda: Transcription(problem()),
    "LexicographicProgram": small_program,
    "LexicographicProgram | SelfSolving": small_program,
    "LexicographicNlp": lambda: nlp.LexicographicNlp(small_program()),
    "Sequence[NlpLevel]": lambda: [nlp.NlpLevel(y=ca.SX.sym("x", 2))],
    "PlanRequest": path_request,
    "PlanResult": path_result,
    "CollisionPlan": path_plan,
    "Goal": tool,
    "ToolGoal": tool,
    "PostureGoal": lambda: planning.PostureGoal(joints={"joint1": 0.1}),
    "Obstacle": rock,
    "Sequence[Obstacle]": lambda: [rock()],
    "ObstacleMeta": data,
    "coal.CollisionGeometry": lambda: coal.Sphere(0.2),
    "pin.SE3": pin.SE3.Identity,
    "pin.Model": lambda: robot().model,
    "StateEstimate": state_estimate,
    "State": state,
    "Readings": readings,
    "Fault": fault,
    "Command": lambda: Command(v=np.zeros(robot().n_v)),
    "TickInputs": tick,
    "MissionState": lambda: scenario().mission.start(),
    "Phase": phase,
    "Abort": abort,
    "ActuationFeedback": ActuationFeedback,
    "tuple[Phase, ...]": lambda: (phase(),),
    "tuple[Transition, ...]": lambda: (transition(),),
    "tuple[Condition, ...]": lambda: (below(),),
    "tuple[tuple[Condition, float], ...]": lambda: ((below(), 0.05),),
    "Below": below,
    "Above": lambda: mission.Above(quantity="HA.tilt", limit=0.1),
    "Transition": transition,
    "Mapping[str, float]": lambda: {"HA": 0.5},
    "Hierarchy": lambda: tasks.Hierarchy([tasks.HorizontalAttitude()]),
    "Sequence[Task]": lambda: [tasks.HorizontalAttitude()],
    "Task": keyed(tasks.VehiclePose, goal=pin.SE3.Identity()),
    "TaskClass": lambda: tasks.TaskClass.ACTION,
    "HierarchySolver": solvers.LexicographicActiveSet,
    "KinematicController": controller,
    "DynamicController": dynamic_controller,
    "Level": level,
    "Sequence[Level]": lambda: [level()],
    "Seafloor": lambda: sim.FlatSeafloor(z=-60.0),
    "FlatSeafloor": lambda: sim.FlatSeafloor(z=-60.0),
    "Current": sim.StillWater,
    "StillWater": sim.StillWater,
    "UniformCurrent": lambda: sim.UniformCurrent([0.1, 0.0, 0.0]),
    "OnsetCurrent": lambda: sim.OnsetCurrent([0.1, 0.0, 0.0], start=1.0, rise=1.0),
    "ShearedCurrent": lambda: sim.ShearedCurrent(
        z=np.array([0.0, 1.0]), velocities=np.zeros((2, 3))
    ),
    "GustyCurrent": lambda: sim.GustyCurrent(base=sim.StillWater()),
    "HeightField": lambda: sim.HeightField.random("small", z=-60.0, extent=5.0),
    "Bathymetry": lambda: sim.Bathymetry(
        x=np.arange(2.0), y=np.arange(2.0), z=np.full((2, 2), -60.0)
    ),
    "Altimeter": lambda: sim.Altimeter(robot(), sim.FlatSeafloor(z=-60.0)),
    "SensorSuite": suite,
    "KinematicPlant": lambda: sim.KinematicPlant(robot(), q()),
    "DynamicPlant": dynamic_plant,
    "PassThrough": lambda: control.PassThrough(robot()),
    "Estimator": lambda: control.Estimator(robot()),
    "Outcome": lambda: control.Outcome(t=1.0, squared=2.0, degrees=3, accepted=True),
    "Nmpc": nmpc,
    "Watchdog": Watchdog,
    "BufferedFunction": lambda: BufferedFunction(dynamics().symbolic.function("mass_matrix")),
    "ca.Function": levels_function,
    "ca.SX": lambda: ca.SX.sym("a", robot().n_v),
    "Setup": lambda: scenario().setup(),
    "PreflightReport": lambda: PreflightReport(findings=()),
    "Severity": lambda: next(iter(Severity)),
    "tuple[Finding, ...]": lambda: (Finding(severity=next(iter(Severity)), check="a", text="b"),),
    "RunOptions": lambda: RunOptions(robot=robot(), seabed=-60.0),
    "ScenePage": lambda: ScenePage(html="<p>"),
    "SmoothActivation": lambda: tasks.SmoothActivation(0.1, 0.2),
    "SensorSpec": SensorSpec,
    "Trust": lambda: Trust.GOOD,
    "RobotDescription": lambda: robot().description,
    "WarmStart": lambda: stage_solver().solve_flat(stagewise.StageQp(stage_shape())).warm_start(),
    "SensorSpecs": lambda: IDEAL_SENSORS,
    "RealTimeSqp": sqp,
    "StageShape": stage_shape,
    "StageQp": lambda: stagewise.StageQp(stage_shape()),
    "StageQpSolver": stage_solver,
    "StageQpSolution": lambda: stage_solver().solve(stagewise.StageQp(stage_shape())),
    "KktResidual": lambda: stagewise.KktResidual(stationarity=0.0, primal=0.0, complementarity=0.0),
    "tuple[Array, ...]": lambda: (np.zeros(2),),
    "StageQpStatus": lambda: next(iter(stagewise.StageQpStatus)),
    "Icat": solvers.Icat,
    "LexicographicQp": solvers.LexicographicQp,
    "LexicographicActiveSet": solvers.LexicographicActiveSet,
    "Solution": lambda: solvers.Icat().solve([level()]),
    "Status": lambda: solvers.Status.SOLVED,
    "Ball": lambda: ocp.Ball(radius=0.1),
    "Clearance": clearance,
    "Kinematics": lambda: Kinematics(robot(), q()),
    "CollisionModel": lambda: CollisionModel(robot(), [rock()]),
    "Expression": lambda: ca.SX.sym("x", 2),
    "NlpStatus": lambda: next(iter(nlp.NlpStatus)),
    "OcpStatus": lambda: next(iter(ocp.OcpStatus)),
    "PlanStatus": lambda: next(iter(planning.PlanStatus)),
    "Value": lambda: 1.0,
    "str | None": lambda: None,
    "Markers": dict,
    "Sequence[SymbolicPose]": poses,
    "FiniteTriple": lambda: (12.3, 37.0, -38.5),
    "tuple[int, ...]": lambda: (1, 1),
    "tuple[float, float]": lambda: (0.0, 0.0),
    "tuple[float, float, float]": lambda: (0.0, 0.0, 0.0),
    "float | tuple[float, float]": lambda: 1.0,
    "ca.SX | float": lambda: 0.15,
    "Relief | str": lambda: "small",
    "Sequence[Any]": lambda: (1, 2),
    "tuple[Row, ...]": lambda: ({"a": 1},),
    "CollisionPlan | None": path_plan,
    "SymbolicDynamics": lambda: dynamics().symbolic,
    "tuple[Ball, ...]": lambda: (ocp.Ball(radius=0.1),),
    "Callable[[Any], Row]": lambda: lambda case: {"case": case},
    "Callable[[Sequence[Row]], Sequence[Row]]": lambda: lambda rows: rows,
    "tuple[OcpLevel, ...]": lambda: problem().levels,
    "Sequence[OcpLevel]": lambda: problem().levels,
    "tuple[OcpPhase, ...]": lambda: problem().phases,
    "tuple[Term, ...]": lambda: (ocp.Smoothness(),),
    "LandingAltitude": tasks.LandingAltitude,
    "MinimumAltitude": tasks.MinimumAltitude,
    "HorizontalAttitude": tasks.HorizontalAttitude,
    "JointLimits": tasks.JointLimits,
    "Manipulability": tasks.Manipulability,
    "NullVelocity": tasks.NullVelocity,
    "UnderActuation": keyed(tasks.UnderActuation, axes=(1,)),
    "Alignment": keyed(tasks.Alignment, goal=np.ones(3)),
    "FieldOfView": keyed(tasks.FieldOfView, goal=np.ones(3)),
    "JointTracking": keyed(tasks.JointTracking, joints=("joint1",), goal=np.zeros(1)),
    "ToolPosition": keyed(tasks.ToolPosition, goal=pin.SE3.Identity()),
    "ToolPose": keyed(tasks.ToolPose, goal=pin.SE3.Identity()),
    "AtRest": ocp.AtRest,
    "Duration": ocp.Duration,
    "Effort": ocp.Effort,
    "Energy": ocp.Energy,
    "Smoothness": ocp.Smoothness,
    "Term": ocp.Smoothness,
    "Posture": lambda: ocp.Posture(q=q()),
    "TaskTerm": lambda: ocp.TaskTerm(task=tasks.VehiclePose(goal=pin.SE3.Identity())),
    "ShapeClearance": lambda: ocp.ShapeClearance(scene=scene(), margins=np.zeros(scene().n_pairs)),
    "BallClearance": lambda: ocp.BallClearance(
        robot_balls=(ocp.Ball(radius=0.1),), obstacles=(ocp.Ball(radius=0.1),)
    ),
}
"""Right values by annotation, and the values on which methods are called by the name of their
class.
"""

ARGUMENTS: dict[str, Callable[[], Arguments]] = {
    **dict.fromkeys(
        ("Estimator.outcome", "Estimator.refuse", "Estimator.used"), lambda: {"channel": "position"}
    ),
    **dict.fromkeys(
        ("Above.holds", "Above.describe", "Below.holds", "Below.describe", "Transition.describe"),
        lambda: {"quantities": quantities()},
    ),
    "StageShape": lambda: {"n_u": (1,)},
    "KktResidual": lambda: {"stationarity": 0.0, "primal": 0.0, "complementarity": 0.0},
    "StageQp.fix_initial_state": lambda: {"x": np.zeros(2)},
    "Mission.pending": lambda: {"quantities": quantities()},
    "Mission.step": lambda: {"quantities": quantities()},
    "Alignment": lambda: {"goal": np.ones(3)},
    "Alignment.rows": lambda: parameters(3 + 3),
    "Alignment.residual": lambda: parameters(3 + 3),
    "FieldOfView": lambda: {"goal": np.ones(3)},
    "FieldOfView.rows": lambda: parameters(6),
    "ToolPosition": lambda: {"goal": pin.SE3.Identity()},
    "ToolPosition.rows": lambda: parameters(6),
    "ToolPosition.residual": lambda: parameters(6),
    "ToolPose": lambda: {"goal": pin.SE3.Identity()},
    "VehiclePose": lambda: {"goal": pin.SE3.Identity()},
    "JointTracking": lambda: {"joints": ("joint1",), "goal": np.zeros(1)},
    "JointTracking.rows": lambda: parameters(2),
    "JointTracking.residual": lambda: parameters(2),
    "Clearance.rows": lambda: parameters(clearance().n_parameters(robot())),
    "SmoothActivation": lambda: {"start": 0.0, "end": 1.0},
    "BufferedFunction.__call__": dict,
    "BufferedFunction.adopt": dict,
    "CoalDistances.near": lambda: {"thresholds": np.full(len(scene().pairs), 0.1)},
    "CollisionScene": lambda: fields_of(scene()),
    "CollisionScene.per_pair": lambda: {"of_obstacles": 0.1, "of_links": 0.02},
    "CollisionScene.check_no_overlap": lambda: {"distances": np.ones(len(scene().pairs))},
    "CollisionScene.nearest": lambda: {
        "t": np.arange(2.0),
        "distances": np.ones((2, len(scene().pairs))),
    },
    "CollisionPlan": lambda: fields_of(path_plan()),
    "Coordinates": lambda: fields_of(scene().coordinates),
    "Coordinates.shortest_turn": lambda: {"near": scene().coordinates.x(q())},
    "DynamicPlant.ask": lambda: {"command": full_command()},
    "DynamicPlant.step": lambda: {"command": full_command(), "dt": 0.001},
    "KinematicPlant.step": lambda: {"dt": 0.001},
    "HeightField": lambda: {
        "centres": np.zeros((1, 2)),
        "heights": np.ones(1),
        "radii": np.ones(1),
    },
    "HeightField.random": lambda: {"extent": 5.0},
    "Bathymetry": lambda: {"x": np.arange(2.0), "y": np.arange(2.0), "z": np.zeros((2, 2))},
    "Bathymetry.read": lambda: {"path": _survey_file()},
    "Bathymetry.ground_at": lambda: {"points": np.zeros((2, 2))},
    "FlatSeafloor.ground_at": lambda: {"points": np.zeros((2, 2))},
    "HeightField.ground_at": lambda: {"points": np.zeros((2, 2))},
    "Icat.velocity": lambda: {
        "J": np.eye(2),
        "rate": np.ones(2),
        "activation": np.ones(2),
        "sizes": (2,),
    },
    "Level": lambda: {"jacobian": np.eye(2)},
    "LevelsProblem": lambda: fields_of(controller().problem),
    "LexicographicNlp.rows_at": lambda: {"x": np.zeros(2), "p": np.zeros(0)},
    "LexicographicNlp.solve": lambda: {"start": np.zeros(2)},
    "LexicographicProgram.rows_at": lambda: {"x": np.zeros(2), "p": np.zeros(0)},
    "LexicographicProgram.violation": lambda: {
        "x": np.zeros(2),
        "p": np.zeros(0),
        "bounds": row_bounds(small_program().ranges, -np.inf, np.inf, 2),
    },
    "LexicographicProgram": lambda: fields_of(small_program()),
    "LexicographicResult": lambda: fields_of(plan().result),
    "RealTimeSqp": lambda: {"program": Transcription(problem()).program},
    "RealTimeSqp.solve": lambda: {"x": np.zeros(nmpc_x()), "p": nmpc_p()},
    "Planner.solve": lambda: {
        "p": planner().transcription.parameters(problem()),
        "guess": plan().trajectory,
    },
    "Plan": lambda: fields_of(plan()),
    "MissionPlan": lambda: fields_of(whole()),
    "plan_mission": lambda: {
        "scenario": reach(plant="kinematic", duration=0.05),
        "options": nlp.NlpOptions(max_iterations=1),
        "step": 60.0,
    },
    "MissionPlan.load": lambda: {"path": whole().save(Path(mkdtemp(), "plan.npz"))},
    "ScenePage.save": lambda: {"path": Path(mkdtemp(), "page.html")},
    "MissionPlan.save": lambda: {"path": Path(mkdtemp(), "plan.npz")},
    "show": lambda: {"what": robot(), "robot_or_q": q()},
    "figure_of": lambda: {"name": "q"},
    "Plan.load": lambda: {"path": plan().save("plan.npz")},
    "replay": lambda: {"plan": plan(), "where": from_pool("Where", "where")},
    "estimate_recording": lambda: {"recording": noisy_run(), "robot": reach().robot},
    "Trajectory": lambda: fields_of(plan().trajectory),
    "Trajectory.leaving": lambda: {"model": arm().model},
    "Trajectory.state_at": lambda: {"model": arm().model},
    "Trajectory.states_at": lambda: {"model": arm().model, "t": np.array([0.0, 0.5])},
    "Posture": lambda: {"q": arm().configuration()},
    "MinSnap": lambda: fields_of(
        trajectories.min_snap(curve().evaluate([0.0, 1.0, 2.0]), [0.0, 1.0, 2.0])
    ),
    "Abort": lambda: {"phase": climb()},
    "MissionState": lambda: {"activations_before": np.zeros(13), "held_since": (None,)},
    "Mission.tasks_of": lambda: {"phase": 0},
    "NlpLevel": lambda: {"y": ca.SX.sym("x", 2)},
    "Nmpc.__call__": lambda: {"estimate": arm_estimate()},
    "ObstacleMeta": lambda: data().model_dump(),
    "OcpProblem": lambda: fields_of(problem()),
    "OcpRequest": lambda: {"goal": tool(), "n_steps": 2},
    "PlanRequest": lambda: {"goal": tool()},
    "PassThrough.__call__": lambda: {"t": 0.0},
    "PiecewisePolynomial": lambda: fields_of(curve()),
    "PiecewisePolynomial.evaluate": lambda: {"t": [0.0, 0.5]},
    "PiecewisePolynomial.from_numpy": lambda: {"path": _curve_file()},
    "PiecewisePolynomial.axes": lambda: {"indices": [0]},
    "Record.load": lambda: {"path": RECORDS / "run_v0_1.npz"},
    "Residual": lambda: {"value": ca.SX.sym("y", 1), "lower": np.zeros(1), "upper": np.zeros(1)},
    "Robot": lambda: fields_of(robot()),
    "Robot.arm_shapes": lambda: {"tool": "tool"},
    "Robot.frame_id": lambda: {"name": "tool"},
    "Robot.joint": lambda: {"name": "joint1"},
    "Robot.with_water_density": lambda: {"density": 1000.0},
    "Robot.configuration": dict,
    "ShearedCurrent": lambda: {"z": np.array([0.0, 1.0]), "velocities": np.zeros((2, 3))},
    "ShearedCurrent.over_floor": lambda: {"floor_z": -60.0},
    "Solution": lambda: {"v": np.zeros(2), "residuals": (np.zeros(2),)},
    "TickResult": lambda: {"v": np.zeros(2), "residual": np.zeros(2), "extras": ()},
    "SqpResult": lambda: {"x": np.zeros(2)},
    "SymbolicModel.frame": lambda: {"name": "tool"},
    "SymbolicModel.congruence": lambda: {"matrices": [ca.DM.eye(6)] * len(poses())},
    "SymbolicModel.generalized_force": lambda: {"wrenches": wrenches()},
    "SymbolicModel.difference": lambda: {"q0": sx("q0"), "q1": sx("q1")},
    "SymbolicModel.forward_kinematics": lambda: {"q": sx("q")},
    "SymbolicModel.local_poses": lambda: {"q": sx("q")},
    "SymbolicModel.integrate": lambda: {"q": sx("q")},
    "Task.with_goal": lambda: {"goal": pin.SE3.Identity()},
    "TaskTerm.residual": lambda: parameters(18),
    "Posture.residual": lambda: parameters(robot().model.nq),
    "BallClearance.residual": lambda: parameters(POOL["BallClearance"]().n_parameters(robot())),
    **{f"CoalDistances.{kind}": lambda: {"q": q()[None]} for kind in ("contacts", "distances_at")},
    "ShapeClearance": lambda: {"scene": scene(), "margins": np.zeros(scene().n_pairs)},
    **{
        f"{kind}.references": lambda: {"times": [0.0], "q": q()[None]}
        for kind in ("Term", "ShapeClearance")
    },
    "ShapeClearance.distances": lambda: {"times": [0.0], "q": q()[None]},
    "ShapeClearance.obstacle_motion": lambda: {"times": np.zeros(1), "half": np.full(1, 0.1)},
    "ShapeClearance.mismatch": lambda: {"times": [0.0], "written": q()[None], "q": q()[None]},
    "ShapeClearance.residual": lambda: parameters(POOL["ShapeClearance"]().n_parameters(robot())),
    "ToolGoal.as_tasks": lambda: {"start": q()},
    "check_clearance": lambda: {"trajectory": motion()},
    "clearance_along": lambda: {"trajectory": motion()},
    "closest_approach": lambda: {"q": np.array([q(), q()])},
    "concatenate": lambda: {"curves": [curve(), curve().shifted(2.0)]},
    "figure_paths": lambda: {"paths": {"a": np.zeros((3, 3))}},
    "figure_joint_comparison": lambda: {"records": {"a": run_record(), "b": run_record()}},
    "figure_several_runs": lambda: {"runs": {"a": run_record(), "b": run_record()}},
    "compare": lambda: {"first": run_record(), "second": run_record()},
    "figure_transitions": lambda: {"runs": {"a": report.transition_series(run_record())}},
    "figure_rate": lambda: {"success": np.array([True, False])},
    "figure_spread": lambda: {
        "values": {"energy [J]": np.array([1.0, 2.0])},
        "success": np.array([True, False]),
    },
    "Robot.with_joint_values": lambda: {"q": q(), "values": robot().joint_values(q())},
    "trimmed": lambda: {"robot": load_robot("bluerov2_alpha5"), "bow": 0.2, "stern": -0.2},
    "check_robot_files": lambda: {"path": robot_folder("planar5")},
    "determined_by_goal": lambda: {"reference": lambda task, t: np.zeros(3)},
    "equality_rows": lambda: {"jacobian": ca.SX.eye(2), "rate": ca.SX.zeros(2)},
    "figure_clearance": lambda: {"record": curve_record()},
    "figure_joint_motion": lambda: {"record": curve_record()},
    "figure_vehicle_motion": lambda: {"record": curve_record()},
    "write_plan_figures": lambda: {"record": curve_record()},
    "floor_mesh": lambda: {"extent": 2.0},
    "floor_obstacle": lambda: {"extent": 2.0},
    "floor_relief": lambda: {"low": np.zeros(2), "high": np.ones(2)},
    "load_robot": lambda: {"name": "planar5"},
    "robot_folder": lambda: {"name": "planar5"},
    "mesh_shape": lambda: {"vertices": np.eye(3), "triangles": np.array([[0, 1, 2]])},
    "mount": lambda: {"vehicle": without_arm(robot()), "arm": arm()},
    "parse_obstacle": lambda: {"shape": "sphere", "words": "1 2 3 0.3"},
    "ocp_record": lambda: {"result": ocp_result()},
    "plan_soft_collision": lambda: {"waypoints": two_postures(), "limits": limits()},
    "read_obstacles": lambda: {"path": _obstacle_file()},
    "sampled_waypoints": lambda: {"start": two_postures()[0], "goal": two_postures()[1]},
    "simulate": lambda: simulation(),
    "single_phase": lambda: {"robot": arm(), "start": problem().start, "n_steps": 2},
    "guess_through": lambda: {"configurations": np.array([arm().configuration()] * 3)},
    "tool_goal": lambda: {"goal": pin.SE3.Identity(), "guess": two_postures()[0]},
    "hold_guess": dict,
    "lexicographic_program": lambda: lexicographic(),
    "Campaign": lambda: {"scenario": scenario, "runs": 2},
    "Campaign.run": lambda: {"out": _campaign_folder()},
    "Campaign.scenario_of": lambda: {"run": 0},
    "Choice": lambda: {"values": (1.0, 2.0)},
    "Uniform": lambda: {"lower": 0.0, "upper": 1.0},
    "Normal": lambda: {"mean": 0.0, "sigma": 1.0},
    "Triangular": lambda: {"lower": 0.0, "mode": 0.5, "upper": 1.0},
    **{
        f"{name}.quantile": lambda: {"u": 0.5}
        for name in ("Choice", "LogNormal", "Normal", "Triangular", "Uniform")
    },
    "Variation": lambda: {"name": "start.x", "distribution": Uniform(0.0, 1.0)},
    "campaign_report": lambda: {"folder": _campaign_folder()},
    "compare_campaigns": lambda: {"first": _campaign_folder(), "second": _campaign_folder()},
    "Record.from_mcap": lambda: {"path": _mcap()},
    "Record.from_parquet": lambda: {"path": _parquet()},
    "read_table": lambda: {"folder": _campaign_folder()},
    "vary": lambda: {"values": {"tasks.HA.gain": 0.5}},
    "Fault": lambda: {"target": "depth", "kind": "lost"},
    "Channel": lambda: {"name": "beacon", "unit": "m"},
    "parse_fault": lambda: {"text": "depth:lost@1"},
    "scale_to_limits": dict,
}
"""What a call needs beyond the pool."""


def _mcap() -> Path:
    run_record().to_mcap("record.mcap")
    return Path("record.mcap").resolve()


def _parquet() -> Path:
    run_record().to_parquet("record.parquet")
    return Path("record.parquet").resolve()


def _campaign_folder() -> Path:
    """Of a campaign with one run that is finished; it has no rows of others."""
    campaign = _campaign()
    folder = Path(mkdtemp())
    with opened(folder, campaign.identity(), {}) as store:
        store.add(attempt_job(campaign.work, 0, "here"))
    return folder


@cache
def _campaign() -> Campaign:
    return Campaign(scenario=scenario, runs=1)


REFUSES = {
    "Task.residual",
    "BufferedFunction.__call__",
    "BufferedFunction.write",
    *(["export_controller"] if MISSING else []),
}
"""Calls that are never right: the base class of tasks refuses, a list of arguments has no names, an
export needs a compiler.
"""

EXPENSIVE = {
    *("write_figures", "write_plan_figures", "write_scene", "show"),
    *("solve_ocp", "plan_path", "plan_soft_collision"),
    *(
        "Nmpc",
        "Planner",
        "Planner.plan",
        "Planner.solve",
        "RealTimeSqp",
        "RealTimeSqp.solve",
        "plan",
        "plan_mission",
    ),
    *(
        "DynamicPlant",
        "robot_dynamics",
        "Dynamics",
        "case2",
        "sampled_waypoints",
        "check_mission",
        "figure_joints",
    ),
    *("figure_tick_time", "compile_library", "compile_function"),
}
"""Calls that take half a second or more when they are right, and so are tried with wrong arguments
only.
"""
