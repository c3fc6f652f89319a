"""Trained models, loaded from a run's folder."""

from fluidsnet.models.loading import load as load
