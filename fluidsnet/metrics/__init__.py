"""Metrics of one step and of rollouts."""

from fluidsnet.metrics.base import FrameMean as FrameMean
from fluidsnet.metrics.base import RolloutMetric as RolloutMetric
from fluidsnet.metrics.density import Density as Density
from fluidsnet.metrics.density import DensityError as DensityError
from fluidsnet.metrics.misplaced_volume import MisplacedVolume as MisplacedVolume
from fluidsnet.metrics.one_step import PositionError as PositionError
from fluidsnet.metrics.one_step import Skill as Skill
from fluidsnet.metrics.one_step import TargetError as TargetError
from fluidsnet.metrics.one_step import VelocityMSE as VelocityMSE
from fluidsnet.metrics.point_clouds import Chamfer as Chamfer
from fluidsnet.metrics.point_clouds import Sinkhorn as Sinkhorn
from fluidsnet.metrics.positions import CenterOfMass as CenterOfMass
from fluidsnet.metrics.positions import Escaped as Escaped
from fluidsnet.metrics.positions import MSEn as MSEn
from fluidsnet.metrics.positions import NonFinite as NonFinite
from fluidsnet.metrics.positions import RolloutPositionError as RolloutPositionError
from fluidsnet.metrics.suite import RolloutSuite as RolloutSuite
from fluidsnet.metrics.velocities import KineticEnergy as KineticEnergy
from fluidsnet.metrics.velocities import RolloutVelocityMSE as RolloutVelocityMSE
