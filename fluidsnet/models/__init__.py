"""Models, loaded from the folder of a run, by the name of a shipped model, or from a config."""

from fluidsnet.models.loading import config_path as config_path
from fluidsnet.models.loading import load as load
from fluidsnet.models.shipped import shipped_models as shipped_models
