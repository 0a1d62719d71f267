"""Hooks of mkdocs: the pages of docs/, which are written for GitHub, as pages of the site."""

import os
import posixpath
import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File

ROOT = Path(__file__).resolve().parents[2]
# Pages that do not lie in docs/, by their place on the site.
FROM_OUTSIDE = {
    "index.md": "README.md",
    "changes.md": "CHANGELOG.md",
    "contributing.md": "CONTRIBUTING.md",
}
LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\((?!https?:|#)([^)\s#]+)(#[^)\s]*)?\)")
FENCE = re.compile(r"(^```.*?^```)", re.DOTALL | re.MULTILINE)


def on_files(files: Any, config: Any) -> Any:
    """Add the pages that lie outside docs/."""
    for place, source in FROM_OUTSIDE.items():
        text = (ROOT / source).read_text(encoding="utf-8")
        files.append(File.generated(config, place, content=text))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    """Convert links for the site."""
    source = FROM_OUTSIDE.get(page.file.src_uri, f"docs/{page.file.src_uri}")
    parts = FENCE.split(markdown)
    parts[::2] = [LINK.sub(lambda found: link(found, source), part) for part in parts[::2]]
    return "".join(parts)


def link(found: re.Match[str], source: str) -> str:
    """The link on the site for a link to a file of the repository."""
    mark, text, target, anchor = found.group(1), found.group(2), found.group(3), found.group(4)
    path = posixpath.normpath(posixpath.join(posixpath.dirname(source), target))
    outside = {name: place for place, name in FROM_OUTSIDE.items()}
    if path in outside:
        path = outside[path]
    elif path.startswith("docs/") and (ROOT / path).is_file():
        path = path.removeprefix("docs/")
    elif repository := os.environ.get("GITHUB_REPOSITORY"):
        path = f"https://github.com/{repository}/blob/main/{path}"
    else:
        return text  # without a place on the web the file has no address
    return f"{mark}[{text}]({path}{anchor or ''})"
