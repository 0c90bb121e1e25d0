from .comparison import (
    compare as compare,
    transition_series as transition_series,
    transition_table as transition_table,
)
from .end_of_run import cause_of_end as cause_of_end
from .metrics import (
    max_velocity_step as max_velocity_step,
    quantity as quantity,
)
from .phase_resources import resources as resources
from .planned_motion import (
    motion_record as motion_record,
    ocp_record as ocp_record,
    ocp_report as ocp_report,
    plan_report as plan_report,
)
from .summary import (
    phase_table as phase_table,
    sensor_health as sensor_health,
    summarize as summarize,
)
