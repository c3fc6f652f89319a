"""Models, loaded from the folder of a run or the config of a prior alone."""

from fluidsnet.models.loading import load as load
