"""What is measured; one metric a file."""

from fluidsnet.metrics.frame_mean import FrameMean as FrameMean
from fluidsnet.metrics.position_error import PositionError as PositionError
from fluidsnet.metrics.rollout_errors import RolloutErrors as RolloutErrors
from fluidsnet.metrics.skill import Skill as Skill
from fluidsnet.metrics.target_error import TargetError as TargetError
from fluidsnet.metrics.velocity_mse import VelocityMSE as VelocityMSE
