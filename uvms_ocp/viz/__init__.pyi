from .campaign_figures import figure_rate as figure_rate, figure_spread as figure_spread
from .comparison_figures import (
    figure_joint_comparison as figure_joint_comparison,
    figure_paths as figure_paths,
    figure_transitions as figure_transitions,
)
from .effort_figures import figure_efforts as figure_efforts, figure_tracking as figure_tracking
from .estimate_figures import figure_estimate as figure_estimate
from .health_figures import figure_health as figure_health
from .motion_figures import (
    figure_joints as figure_joints,
    figure_velocities as figure_velocities,
)
from .path_figures import figure_path as figure_path
from .plan_figures import (
    figure_clearance as figure_clearance,
    figure_joint_motion as figure_joint_motion,
    figure_vehicle_motion as figure_vehicle_motion,
    write_plan_figures as write_plan_figures,
)
from .run_figures import (
    plot as plot,
    write_figures as write_figures,
)
from .scene.live import live as live
from .scene.page import ScenePage as ScenePage
from .scene.show import show as show, write_scene as write_scene
from .several_runs import figure_several_runs as figure_several_runs
from .task_figures import (
    figure_activations as figure_activations,
    figure_altitude as figure_altitude,
    figure_errors as figure_errors,
    figure_misalignment as figure_misalignment,
    figure_of as figure_of,
    figure_quantities as figure_quantities,
    figure_row_activations as figure_row_activations,
    figure_tool_error as figure_tool_error,
)
from .time_spans import phase_spans as phase_spans
from .timing_figures import figure_tick_time as figure_tick_time
