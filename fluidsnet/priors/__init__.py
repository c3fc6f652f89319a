"""Steps that a network corrects."""

from fluidsnet.priors.free_fall import FreeFall as FreeFall
from fluidsnet.priors.pressure_step import PressureStep as PressureStep
from fluidsnet.priors.prior import Guess as Guess
from fluidsnet.priors.prior import Prior as Prior
