"""The tutorial is followed from its first command to its last; notebook and site."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import nbformat
import pytest
from documents import ROOT, block_commands, blocks, save_files
from nbclient import NotebookClient

TUTORIAL = ROOT / "docs/tutorial"
NOTEBOOK = ROOT / "docs/notebooks/first_steps.ipynb"
#: What each part leaves, beside what its commands check.
LEFT = {
    "movie": [
        "column.mp4",
        "runs/simulate/box_drops/column.png",
        "runs/simulate/box_drops/column.vtkhdf",
        "runs/simulate/box_drops/column_solids.vtkhdf",
        "runs/simulate/box_drops_40ms/column.vtkhdf",
        "column.usdc",
    ],
    "network": [
        "data/mine/train.h5",
        "runs/mine/checkpoints/best.ckpt",
        "runs/mine/results/mine/one_step.md",
        "runs/mine/results/mine/rollout.png",
        "runs/mine/report/report.html",
        "mine_ply/mine_ply.0010.ply",
        "runs/simulate/mine/test_00000_10.vtkhdf",
    ],
}
# One process for all commands of a page: loading torch takes longer than most of them.
FOLLOW = """
import shlex, sys
from fluidsnet.main import main
for line in sys.stdin.read().splitlines():
    print("$", line, flush=True)
    main(shlex.split(line)[1:])
"""


@pytest.mark.parametrize("part", ["movie", "network"])
def test_the_tutorial_can_be_followed(part: str, tmp_path: Path) -> None:
    page = TUTORIAL / f"{part}.md"
    for name in ("configs", "docs", "tests"):
        (tmp_path / name).symlink_to(ROOT / name)
    save_files(page, tmp_path)
    lines = [it.words for block in blocks(page, "sh") for it in block_commands(block)]
    assert {words[0] for words in lines} == {".", "fluidsnet"}
    ours = [words for words in lines if words[0] == "fluidsnet"]
    _run(FOLLOW, tmp_path, "\n".join(map(shlex.join, ours)))
    for block in blocks(page, "python"):
        _run(block.text, tmp_path)
    for name in LEFT[part]:
        assert (tmp_path / name).stat().st_size > 0, name


def _run(program: str, folder: Path, given: str = "") -> None:
    """Run a Python program in a folder, with the repository's packages."""
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        input=given,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    assert done.returncode == 0, done.stdout


def test_the_notebook_runs_and_shows_what_it_says(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    shown = [_text(cell) for cell in notebook.cells]
    pictures = [_pictures(cell) for cell in notebook.cells]
    client = NotebookClient(
        notebook, timeout=300, resources={"metadata": {"path": str(NOTEBOOK.parent)}}
    )
    client.execute()
    assert [_text(cell) for cell in notebook.cells] == shown
    assert [_pictures(cell) for cell in notebook.cells] == pictures
    assert sum(pictures) == 2


def _text(cell: nbformat.NotebookNode) -> str:
    outputs = cell.get("outputs", [])
    return "".join(it.text for it in outputs if it.output_type == "stream" and it.name == "stdout")


def _pictures(cell: nbformat.NotebookNode) -> int:
    return sum("image/png" in it.get("data", {}) for it in cell.get("outputs", []))


def test_the_site_is_built_without_a_warning(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT), "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert "Truth and prediction side by side" in (tmp_path / "index.html").read_text()
    configs = (tmp_path / "configs.html").read_text()
    for path in (ROOT / "configs").rglob("*.yaml"):
        assert f"configs/{path.relative_to(ROOT / 'configs')}" in configs
    api = (tmp_path / "api.html").read_text()
    for name in ("load", "rollout", "Particles", "Scene", "SPHDataModule", "Ablation"):
        assert re.search(rf'<h3 id="[\w.]+\.{name}"', api), name
    assert "data:image/png" in (tmp_path / "notebooks/first_steps.html").read_text()
