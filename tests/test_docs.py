"""Documents: their commands parse, their links lead somewhere, their Python imports what exists."""

from __future__ import annotations

import argparse
import ast
import re
import shutil
import subprocess
import tomllib
from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import jsonargparse
import lightning
import pytest
import yaml
from documents import (
    DOCUMENTS,
    ROOT,
    Block,
    Command,
    blocks,
    commands,
    github_anchors,
    links,
    save_files,
)

from fluidsnet.main import _COMMANDS, main

COMMANDS = [command for path in DOCUMENTS for command in commands(path)]
MAKE = [it for it in COMMANDS if it.words[0] == "make"]
OURS = [it for it in COMMANDS if it.words[0].rpartition("/")[2] == "fluidsnet"]
PYTHON = [it for it in COMMANDS if it.words[0].rpartition("/")[2] == "python"]
INSTALLS = [it for it in COMMANDS if it.words[0] == "pip"]
#: Programs of others, whose options are theirs.
OTHERS = (".", "tensorboard")
#: What `…` stands for after a command.
USUAL = [f"--config=configs/{name}.yaml" for name in ("trainer", "model/corrected", "data/sample")]
#: What stands for a class that the reader writes.
OWN = {"ReflectAtWalls": "StopAtWalls"}

# It logs to the stderr that there is when it is loaded, which must not be one test's own.
assert lightning


class Accepted(Exception):
    """A parser has accepted the options of a command."""


@pytest.fixture
def stops_when_parsed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ends every command when its own parser has accepted the options, in full length."""

    running: list[Any] = []

    def stopping(parse: Callable[..., Any]) -> Callable[..., Any]:
        def parse_args(self: Any, *arguments: Any, **more: Any) -> Any:
            running.append(self)
            self.allow_abbrev = False
            found = parse(self, *arguments, **more)
            running.pop()
            if running:  # the parser of a subcommand
                return found
            raise Accepted

        return parse_args

    for parser in (argparse.ArgumentParser, jsonargparse.ArgumentParser):
        monkeypatch.setattr(parser, "parse_args", stopping(parser.parse_args))


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with the repository's files in it."""
    for name in ("configs", "docs", "tests"):
        (tmp_path / name).symlink_to(ROOT / name)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("command", OURS, ids=str)
def test_a_command_is_accepted_by_its_parser(
    command: Command, folder: Path, stops_when_parsed: None
) -> None:
    given = [OWN.get(word, re.sub(r", …(?=])", "", word)) for word in command.words[1:]]
    if "…" in given:
        at = given.index("…")
        given[at : at + 1] = USUAL
    save_files(command.path, folder)
    for name in re.findall(r"\bruns/[\w/]+|\bRUN\b", " ".join(given)):
        run = folder / name.removesuffix("/config").partition("/checkpoints")[0]
        if not run.exists():
            shutil.copytree(ROOT / "tests/data/old_run", run)
    if "--help" in given:
        with pytest.raises(SystemExit) as ended:
            main(given)
        assert ended.value.code == 0
    else:
        with pytest.raises(Accepted):
            main(given)


@pytest.mark.parametrize(
    "words",
    [
        ["fit", *USUAL, "--trainer.max_step", "4"],
        ["fit", *USUAL, "--trainer.max_steps", "many"],
        ["fit", *USUAL, "--model.init_args.walls", "Wall"],
        ["test", "--run", "tests/data/old_run", "--data.init_args.strides", "2"],
        ["trade", "--models", "[{modle: box_drops}]"],
        ["generate", "--config", "configs/scene/sample.yaml", "--root", "x", "--recipe.trian", "1"],
        ["inspect", "--stride", "x"],
        ["inspect", "--strid", "2"],
        ["simulate", "scene.json"],
        ["generat"],
    ],
    ids=" ".join,
)
def test_a_wrong_command_is_refused(
    words: list[str], folder: Path, stops_when_parsed: None
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(words)
    assert ended.value.code in (1, 2)


@pytest.mark.parametrize("command", MAKE, ids=str)
def test_a_make_command_has_its_target(command: Command) -> None:
    done = subprocess.run(
        ["make", "--dry-run", *command.words[1:]], cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("command", PYTHON, ids=str)
def test_a_python_command_names_a_module_and_files_that_exist(command: Command) -> None:
    assert command.words[1] == "-m"
    assert find_spec(command.words[2])
    assert all((ROOT / word).exists() for word in command.words[3:] if "/" in word)


@pytest.mark.parametrize("command", INSTALLS, ids=str)
def test_a_pip_command_names_an_extra_that_exists(command: Command) -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    (extra,) = re.findall(r"fluidsnet\[(\w+)\]", " ".join(command.words))
    assert extra in extras["optional-dependencies"]


def test_every_command_of_a_block_is_checked() -> None:
    checked = {*MAKE, *OURS, *PYTHON, *INSTALLS}
    left = [it for it in COMMANDS if it not in checked and it.words[0] not in OTHERS]
    assert len(OURS) > 100
    assert left == []


def test_the_page_of_commands_has_them_all() -> None:
    page = (ROOT / "docs/commands.md").read_text()
    assert set(re.findall(r"`fluidsnet (\w+)", page)) == set(_COMMANDS)


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda it: str(it.relative_to(ROOT)))
def test_links_lead_to_files_and_headings(path: Path) -> None:
    broken = []
    for link in links(path):
        name, _, anchor = link.partition("#")
        target = path.parent / name if name else path
        if not target.exists() or (anchor and anchor not in github_anchors(target)):
            broken.append(link)
    assert broken == []


_PYTHON_BLOCKS = [
    it for path in DOCUMENTS if path.stem != "CONTRIBUTING" for it in blocks(path, "python")
]


@pytest.mark.parametrize("block", _PYTHON_BLOCKS, ids=str)
def test_python_compiles_and_imports_what_exists(block: Block) -> None:
    for node in ast.walk(ast.parse(block.text)):
        if isinstance(node, ast.Import):
            for it in node.names:
                import_module(it.name)
        elif isinstance(node, ast.ImportFrom):
            module = import_module(node.module or "")
            assert all(hasattr(module, it.name) for it in node.names)


@pytest.mark.parametrize(
    "block", [it for path in DOCUMENTS for it in blocks(path, "yaml")], ids=str
)
def test_yaml_names_classes_that_exist(block: Block) -> None:
    assert yaml.safe_load(block.text)
    for name in re.findall(r"class_path: ([\w.]+)", block.text):
        module, _, kind = name.rpartition(".")
        # In CONTRIBUTING the class is the reader's own.
        if block.path.stem != "CONTRIBUTING":
            assert hasattr(import_module(module), kind), name
