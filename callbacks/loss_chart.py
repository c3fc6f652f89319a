"""Training and validation loss in one chart."""

from __future__ import annotations

from lightning import Callback, LightningModule, Trainer

from fluidsnet.errors import UserError
from fluidsnet.module import FluidsNet
from fluidsnet.reporting.charts import Charts, ChartSource


class LossChart(Callback, ChartSource):
    """Draw training and validation loss against iterations into one chart (paper, figure 6).

    It is in TensorBoard's tab "Custom Scalars", with the charts of `RolloutMetrics` and `Ablation`.
    """

    def charts(self, module: FluidsNet) -> Charts:
        return {"training": {"loss": ["train/loss", "val/loss"]}}

    def setup(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Checks who is trained.

        Raises:
            UserError: the module is not a FluidsNet.
        """
        if not isinstance(pl_module, FluidsNet):
            raise UserError("LossChart knows the losses of FluidsNet alone.")

    def on_fit_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Writes the charts."""
        assert isinstance(pl_module, FluidsNet)
        self.write_charts(trainer, pl_module)
