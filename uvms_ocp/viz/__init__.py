"""Figures and 3-D scenes of a `Record`; the only package that imports Matplotlib and meshcat."""

from uvms_ocp.viz.activation_figures import figure_activations as figure_activations
from uvms_ocp.viz.activation_figures import figure_row_activations as figure_row_activations
from uvms_ocp.viz.comparison import figure_joint_comparison as figure_joint_comparison
from uvms_ocp.viz.comparison import figure_paths as figure_paths
from uvms_ocp.viz.comparison import figure_transitions as figure_transitions
from uvms_ocp.viz.efforts import figure_efforts as figure_efforts
from uvms_ocp.viz.efforts import figure_tracking as figure_tracking
from uvms_ocp.viz.estimate import figure_estimate as figure_estimate
from uvms_ocp.viz.health_figure import figure_health as figure_health
from uvms_ocp.viz.motion_figures import figure_joints as figure_joints
from uvms_ocp.viz.motion_figures import figure_velocities as figure_velocities
from uvms_ocp.viz.path import figure_path as figure_path
from uvms_ocp.viz.plan_figures import figure_clearance as figure_clearance
from uvms_ocp.viz.plan_figures import figure_joint_motion as figure_joint_motion
from uvms_ocp.viz.plan_figures import figure_vehicle_motion as figure_vehicle_motion
from uvms_ocp.viz.plan_figures import plot as plot
from uvms_ocp.viz.plan_figures import write_plan_figures as write_plan_figures
from uvms_ocp.viz.quantity_figures import figure_altitude as figure_altitude
from uvms_ocp.viz.quantity_figures import figure_errors as figure_errors
from uvms_ocp.viz.quantity_figures import figure_misalignment as figure_misalignment
from uvms_ocp.viz.quantity_figures import figure_tool_error as figure_tool_error
from uvms_ocp.viz.run_figures import write_figures as write_figures
from uvms_ocp.viz.scene.show import show as show
from uvms_ocp.viz.scene.show import write_scene as write_scene
from uvms_ocp.viz.scene.viewer import ScenePage as ScenePage
from uvms_ocp.viz.tick_time import figure_tick_time as figure_tick_time
