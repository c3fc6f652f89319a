"""What is measured; one metric a file."""

from fluidsnet.metrics.center_of_mass import CenterOfMass as CenterOfMass
from fluidsnet.metrics.chamfer import Chamfer as Chamfer
from fluidsnet.metrics.density import Density as Density
from fluidsnet.metrics.density_error import DensityError as DensityError
from fluidsnet.metrics.escaped import Escaped as Escaped
from fluidsnet.metrics.frame_mean import FrameMean as FrameMean
from fluidsnet.metrics.kinetic_energy import KineticEnergy as KineticEnergy
from fluidsnet.metrics.mse_n import MSEn as MSEn
from fluidsnet.metrics.non_finite import NonFinite as NonFinite
from fluidsnet.metrics.position_error import PositionError as PositionError
from fluidsnet.metrics.rollout_errors import RolloutErrors as RolloutErrors
from fluidsnet.metrics.rollout_metric import RolloutMetric as RolloutMetric
from fluidsnet.metrics.rollout_position_error import RolloutPositionError as RolloutPositionError
from fluidsnet.metrics.rollout_suite import RolloutSuite as RolloutSuite
from fluidsnet.metrics.rollout_velocity_mse import RolloutVelocityMSE as RolloutVelocityMSE
from fluidsnet.metrics.sinkhorn import Sinkhorn as Sinkhorn
from fluidsnet.metrics.skill import Skill as Skill
from fluidsnet.metrics.target_error import TargetError as TargetError
from fluidsnet.metrics.velocity_mse import VelocityMSE as VelocityMSE
