"""Training and validation loss in one chart."""

from __future__ import annotations

from lightning import Callback, LightningModule, Trainer

from fluidsnet.module import FluidsNet
from fluidsnet.reporting.charts import Charts, ChartSource
from fluidsnet.reporting.requirements import require_fluidsnet


class LossChart(Callback, ChartSource):
    """Draw training and validation loss against iterations into one chart (paper, figure 6).

    It is in TensorBoard's tab "Custom Scalars", with the charts of `RolloutMetrics` and `Ablation`.
    """

    def charts(self, module: FluidsNet) -> Charts:
        return {"training": {"loss": ["train/loss", "val/loss"]}}

    def setup(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Check the module."""
        require_fluidsnet(self, pl_module)

    def on_fit_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Write the charts."""
        self.write_charts(trainer, require_fluidsnet(self, pl_module))
