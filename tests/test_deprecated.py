"""Configs, command lines and runs with deprecated names still load."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from fluidsnet.deprecated import DeprecatedNames
from fluidsnet.main import main

OLD = Path(__file__).parent / "data" / "old"


def options(sample: Path, folder: Path) -> list[str]:
    return [
        f"--data.init_args.root={sample}",
        "--trainer.max_steps=2",
        "--trainer.limit_val_batches=2",
        f"--trainer.logger.init_args.save_dir={folder}",
        "--trainer.logger.init_args.name=run",
        "--trainer.logger.init_args.version=",
        "--data.init_args.frame_range=[0,null]",
        "--data.init_args.sample_every=1",
    ]


def warnings(capsys: pytest.CaptureFixture[str]) -> list[str]:
    return [line for line in capsys.readouterr().err.splitlines() if "deprecated names" in line]


def test_old_configs_train_and_the_run_is_tested(
    sample: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # The ablation brings the old trainer, model and data as its base.
    main(["fit", f"--config={OLD / 'ablation/global_feature.yaml'}", *options(sample, tmp_path)])
    (line,) = warnings(capsys)
    for name in ("context → global_feature", "NoContext →", "ForeignContext →", "RolloutTable →"):
        assert name in line
    run = tmp_path / "run"
    config = run / "config.yaml"
    main(["test", f"--run={run}"])
    assert not warnings(capsys)
    # As an old run's folder has it.
    text = config.read_text()
    for current, old in (
        ("global_feature:", "context:"),
        ("block: global_feature", "block: context"),
        ("NoGlobalFeature", "NoContext"),
        ("GlobalFeaturePermutation", "ForeignContext"),
    ):
        assert current in text
        text = text.replace(current, old)
    config.write_text(text)
    main(["test", f"--run={run}"])
    assert len(warnings(capsys)) == 1


def test_an_old_model_is_changed_from_the_command_line(
    sample: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    configs = [OLD / "trainer.yaml", OLD / "model/paper.yaml", OLD / "data/dam_break_small.yaml"]
    main(
        [
            "fit",
            *(f"--config={config}" for config in configs),
            *options(sample, tmp_path),
            *("--model.init_args.context", "fluidsnet.features.context.NoContext"),
            "--trainer.callbacks+=callbacks.RolloutTable",
        ]
    )
    assert len(warnings(capsys)) == 1
    written = yaml.safe_load((tmp_path / "run" / "config.yaml").read_text())["model"]["init_args"]
    path = "fluidsnet.features.NoGlobalFeature"
    assert written["global_feature"]["class_path"] in (
        path,
        path.replace("s.N", "s.global_feature.N"),
    )


def test_names_are_replaced_in_configs() -> None:
    names = DeprecatedNames()
    old = {
        "model": {
            "class_path": "fluidsnet.FluidsNet",
            "init_args": {
                "cells": [1, 2, 3],
                "context": {"class_path": "fluidsnet.features.field.VoxelField"},
                "local": {"class_path": "fluidsnet.features.messages.KernelMessages"},
            },
        },
        # Another class's arguments, and a name that happens to be an old one.
        "data": {"init_args": {"context": 1, "cells": 2}},
        "trainer": {
            "callbacks+": ["callbacks.RolloutTable", "callbacks.ForeignContext"],
            "callbacks": [
                {"class_path": "callbacks.RolloutTable"},
                {
                    "class_path": "callbacks.Ablation",
                    "init_args": {"block": "context", "variant": "NoContext", "name": "NoContext"},
                },
            ],
        },
    }
    assert names.in_config(old) == {
        "model": {
            "class_path": "fluidsnet.FluidsNet",
            "init_args": {
                "grid_shape": [1, 2, 3],
                "global_feature": {"class_path": "fluidsnet.features.voxel_field.VoxelField"},
                "local": {"class_path": "fluidsnet.features.kernel_messages.KernelMessages"},
            },
        },
        "data": {"init_args": {"context": 1, "cells": 2}},
        "trainer": {
            "callbacks+": ["callbacks.GlobalFeaturePermutation"],
            "callbacks": [
                {
                    "class_path": "callbacks.Ablation",
                    "init_args": {
                        "block": "global_feature",
                        "variant": "NoGlobalFeature",
                        "name": "NoContext",
                    },
                },
            ],
        },
    }
    assert names.warning() is not None


@pytest.mark.parametrize(
    ("old", "current"),
    [
        (["--model.context=NoContext"], ["--model.global_feature=NoGlobalFeature"]),
        (
            ["--model.init_args.context", "NoContext"],
            ["--model.init_args.global_feature", "NoGlobalFeature"],
        ),
        (
            ["--model.init_args.context.init_args.seed=1"],
            ["--model.init_args.global_feature.init_args.seed=1"],
        ),
        (["--model.init_args.cells=[1,2,3]"], ["--model.init_args.grid_shape=[1,2,3]"]),
        (
            ["--trainer.callbacks+=callbacks.ForeignContext"],
            ["--trainer.callbacks+=callbacks.GlobalFeaturePermutation"],
        ),
        (
            ["--trainer.callbacks+=callbacks.Ablation", "--trainer.callbacks.block=context"],
            ["--trainer.callbacks+=callbacks.Ablation", "--trainer.callbacks.block=global_feature"],
        ),
        (["--trainer.callbacks+", "callbacks.RolloutTable", "--a=1"], ["--a=1"]),
        (["--trainer.callbacks+=callbacks.RolloutTable", "--a=1"], ["--a=1"]),
    ],
)
def test_names_are_replaced_on_the_command_line(old: list[str], current: list[str]) -> None:
    names = DeprecatedNames()
    assert names.in_arguments(["fit", *old]) == ["fit", *current]
    assert names.warning() is not None


def test_current_names_are_kept_without_a_warning() -> None:
    names = DeprecatedNames()
    arguments = ["fit", "--config=context.yaml", "--model.init_args.contexts=1", "--x=NoContext"]
    assert names.in_arguments(arguments) == arguments
    assert names.warning() is None


def test_a_removed_callback_alone_and_a_model_in_its_own_file() -> None:
    names = DeprecatedNames()
    for removed in ("RolloutTable", {"class_path": "callbacks.RolloutTable"}):
        config = {"trainer": {"callbacks+": removed, "max_steps": 1}}
        assert names.in_config(config) == {"trainer": {"max_steps": 1}}
    model = {"class_path": "fluidsnet.FluidsNet", "init_args": {"context": "NoContext"}}
    changed = names.in_config(model)
    assert changed["init_args"] == {"global_feature": "NoGlobalFeature"}
