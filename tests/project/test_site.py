"""The documentation site is built from docs/ without a broken link."""

import importlib.util
import os
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest
from project import ROOT, SCRIPTS

HAS_MKDOCS = all(map(importlib.util.find_spec, ("mkdocs", "material", "mkdocstrings")))
needs_mkdocs = pytest.mark.skipif(
    not HAS_MKDOCS, reason="the site is built by mkdocs-material and mkdocstrings (extra docs)"
)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The folder of the site, built as CI does."""
    folder = tmp_path_factory.mktemp("site")
    environment = {**os.environ, "PYTHON": sys.executable, "GITHUB_REPOSITORY": "owner/name"}
    done = subprocess.run(
        [SCRIPTS / "document_site", folder], capture_output=True, text=True, env=environment
    )
    assert done.returncode == 0, done.stderr[-3000:]
    assert done.stdout.splitlines()[-1] == f"{folder}/index.html"
    return folder


@needs_mkdocs
def test_every_page_is_on_the_site(site):
    pages = {path.stem for path in (ROOT / "docs").glob("*.md")}
    pages |= {"changes", "contributing"}
    assert {page for page in pages if not (site / page / "index.html").is_file()} == set()
    start = (site / "index.html").read_text(encoding="utf-8")
    for page in pages:
        assert re.search(rf'href="(\./)?{page}/"', start), f"{page} is in no part of the menu"
    assert "A post-step after" in start


@needs_mkdocs
def test_links_out_of_the_documents_lead_to_the_repository(site):
    method = (site / "method" / "index.html").read_text(encoding="utf-8")
    address = "https://github.com/owner/name/blob/main/colmap_edges/edges2d/detection.py"
    assert f'href="{address}"' in method
    contributing = (site / "contributing" / "index.html").read_text(encoding="utf-8")
    assert "docs/architecture.md" not in re.findall('href="([^"]+)"', contributing)
    assert (site / "examples" / "first_steps.ipynb").is_file()


@needs_mkdocs
def test_interface_is_written_from_the_docstrings(site):
    page = (site / "api" / "index.html").read_text(encoding="utf-8")
    assert 'id="colmap_edges.pipeline.reconstruct.reconstruct"' in page
    assert "Reconstruct the 3D edges of a COLMAP model" in page
    assert page.count("doc-contents") > 20


@needs_mkdocs
@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("[a](../README.md#use)", "[a](index.md#use)"),
        ("[a](formats.md)", "[a](formats.md)"),
        ("![a](demo.jpg)", "![a](demo.jpg)"),
        ("[a](../scripts/demo)", "a"),
        ("[`f`](../CHANGELOG.md)", "[`f`](changes.md)"),
        ("[a](https://x.org/y)", "[a](https://x.org/y)"),
    ],
)
def test_links_without_a_place_on_the_web_become_text(monkeypatch, text, place):
    monkeypatch.delenv("GITHUB_REPOSITORY", raising=False)
    pages = runpy.run_path(str(SCRIPTS / "site" / "pages.py"))
    found = pages["LINK"].sub(lambda match: pages["link"](match, "docs/method.md"), text)
    assert found == place


def test_without_mkdocs_the_remedy_is_named(tmp_path):
    python = tmp_path / "python"
    python.write_text("#!/bin/sh\nexit 1\n")
    python.chmod(0o755)
    environment = {**os.environ, "PYTHON": str(python)}
    done = subprocess.run(
        [SCRIPTS / "document_site"], capture_output=True, text=True, env=environment
    )
    assert done.returncode == 1
    assert "pip install 'colmap-edges[docs]'" in done.stderr


def test_pictures_of_the_gallery_are_small():
    pictures = [*(ROOT / "docs" / "gallery").iterdir()]
    page = (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8")
    assert {path.name for path in pictures} == set(re.findall(r"gallery/(\w+\.webp)", page))
    assert max(path.stat().st_size for path in pictures) < 100_000
    assert all(Path(path).suffix == ".webp" for path in pictures)
