"""Hooks of MkDocs: pages that are made from README, CONTRIBUTING, CHANGELOG and configs.

The Markdown files link to one another as GitHub shows them; on the site README is the home page,
and links to files that are no pages lead to the page that has their content.
"""

from __future__ import annotations

import os
import posixpath
import re
from pathlib import Path

import nbconvert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[1]
#: Folders of configs, with what they hold.
FOLDERS = {
    ".": "Settings of a training",
    "model": "Networks and priors",
    "data": "Data of a training",
    "scene": "Scenes that `fluidsnet generate` draws",
    "ablation": "Ablations",
    "study": "Studies",
}

_LINK = re.compile(r"(\]\()([^)\s#]*)(#[^)\s]*)?(\))")
_PAGE_LINK = re.compile(r'href="([^":#]+\.md)(#[^"]*|)"')
_CODE = re.compile(r"^(```.*?^```)", re.MULTILINE | re.DOTALL)


# Where `make setup` links the environment of an installed torch, nbconvert may be in that one, and
# looks for its templates in this one.
os.environ.setdefault("JUPYTER_PATH", str(Path(nbconvert.__file__).parents[4] / "share/jupyter"))


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated pages."""
    pages = {"index.md": (ROOT / "README.md").read_text(), "configs.md": configs_page()}
    pages |= {name: (ROOT / name).read_text() for name in ("CHANGELOG.md", "CONTRIBUTING.md")}
    for name, text in pages.items():
        files.append(File.generated(config, name, content=with_site_links(text, "")))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Return the Markdown of a page with links that hold on the site."""
    return with_site_links(markdown, f"docs/{Path(page.file.src_uri).parent.as_posix()}")


def on_page_content(html: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Return the HTML of a page, with links that MkDocs leaves as they are in a notebook.

    Raises:
        PluginError: A notebook links to a page that does not exist.
    """
    if not page.file.src_uri.endswith(".ipynb"):
        return html

    def replaced(link: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join(page.file.src_uri, "..", link.group(1)))
        file = files.get_file_from_path(target)
        if file is None:
            raise PluginError(f"{page.file.src_uri} links to {link.group(1)}, which does not exist")
        return f'href="{file.url_relative_to(page.file)}{link.group(2)}"'

    return _PAGE_LINK.sub(replaced, html)


def with_site_links(markdown: str, folder: str) -> str:
    """Return Markdown with the links to files outside docs/ replaced by links to pages.

    Args:
        markdown: Text of a page.
        folder: Folder of its file in the repository.
    """
    parts = _CODE.split(markdown)
    parts[::2] = [_LINK.sub(lambda found: _replaced(found, folder), part) for part in parts[::2]]
    return "".join(parts)


def _replaced(link: re.Match[str], folder: str) -> str:
    before, target, anchor, after = link.groups(default="")
    if not target or "://" in target:
        return link.group()
    path = (ROOT / folder / target).resolve()
    if not path.is_relative_to(ROOT):
        return link.group()
    inside = path.relative_to(ROOT)
    up = "../" * (len(Path(folder).parts) - 1)
    if inside == Path("README.md"):
        return f"{before}{up}index.md{anchor}{after}"
    if inside.parts[0] == "configs":
        return f"{before}{up}configs.md#{_anchor(inside)}{after}"
    if inside in (Path("CHANGELOG.md"), Path("CONTRIBUTING.md")):
        return f"{before}{up}{inside}{anchor}{after}"
    if not folder and inside.parts[0] == "docs":
        return f"{before}{inside.relative_to('docs').as_posix()}{anchor}{after}"
    return link.group()


def configs_page() -> str:
    """Return the page of all configs: the comment at the head of each, and its content."""
    lines = [
        "# Configs",
        "",
        "`fluidsnet fit`, `validate`, `test` and `predict` merge the files of `--config` in the "
        "order given: trainer, model, data, then overlays. `generate` takes a file of "
        "`configs/scene`, a study one of `configs/study`.",
    ]
    for folder, title in FOLDERS.items():
        lines += ["", f"## {title}"]
        for path in sorted((ROOT / "configs" / folder).glob("*.yaml")):
            comment, content = split_comment(path.read_text())
            name = path.relative_to(ROOT)
            lines += ["", f"### `{name}` {{ #{_anchor(name)} }}", "", *_text(comment), ""]
            lines += [f'??? abstract "{name.name}"', "", "    ```yaml"]
            lines += [f"    {line}".rstrip() for line in content.splitlines()]
            lines += ["    ```"]
    return "\n".join(lines) + "\n"


def split_comment(text: str) -> tuple[list[str], str]:
    """Return the lines of the comment at the head of a YAML file, and the rest."""
    lines = text.splitlines()
    count = next((at for at, line in enumerate(lines) if not line.startswith("#")), len(lines))
    return [line.removeprefix("#").removeprefix(" ") for line in lines[:count]], "\n".join(
        lines[count:]
    )


def _text(comment: list[str]) -> list[str]:
    """Return a comment as Markdown: indented lines are commands."""
    lines: list[str] = []
    for line in comment:
        if line.startswith("  ") != bool(lines and lines[-1].startswith("    ")):
            lines.append("")
        lines.append(f"  {line}" if line.startswith("  ") else line)
    return lines


def _anchor(path: Path) -> str:
    return path.with_suffix("").as_posix().replace("/", "-")
