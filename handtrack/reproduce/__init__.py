"""Published tables and figures of the seeds, theirs beside ours."""

from .pose_tables import PoseRow as PoseRow
from .pose_tables import PoseTable as PoseTable
from .pose_tables import pose_tables as pose_tables
