"""Lightning callbacks, one per file."""

from callbacks.ablation import Ablation as Ablation
from callbacks.ablation_picture import AblationPicture as AblationPicture
from callbacks.compiled_network import CompiledNetwork as CompiledNetwork
from callbacks.energy_record import EnergyRecord as EnergyRecord
from callbacks.global_feature_permutation import (
    GlobalFeaturePermutation as GlobalFeaturePermutation,
)
from callbacks.hyperparameters import HyperParameters as HyperParameters
from callbacks.loss_chart import LossChart as LossChart
from callbacks.one_step_table import OneStepTable as OneStepTable
from callbacks.prior_baseline import PriorBaseline as PriorBaseline
from callbacks.rollout_mesh import RolloutMesh as RolloutMesh
from callbacks.rollout_metrics import RolloutMetrics as RolloutMetrics
from callbacks.rollout_picture import RolloutPicture as RolloutPicture
from callbacks.rollout_progress import RolloutProgress as RolloutProgress
from callbacks.solid_writer import SolidWriter as SolidWriter
from callbacks.speed_monitor import SpeedMonitor as SpeedMonitor
from callbacks.stress_cases import StressCases as StressCases
from callbacks.trajectory_writer import TrajectoryWriter as TrajectoryWriter
