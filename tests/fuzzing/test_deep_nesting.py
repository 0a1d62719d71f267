"""Files nested deeper than a parser's limit end in a one-line error."""

import click
import pytest
import valid

from colmap_edges.cli.flags import load_toml
from colmap_edges.cli.info import describe
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.evaluation.metrics.poses import load_true_cameras
from colmap_edges.export import edges_json, peers

DEEP = "[" * 100_000


def load_edges(path):
    edges_json.load_edges(path.parent, valid.view_model())


@pytest.mark.parametrize(
    ("name", "text", "read"),
    [
        ("report.json", DEEP, lambda path: describe(path.parent)),
        ("edges.json", DEEP, load_edges),
        ("true_cameras.json", DEEP, load_true_cameras),
        ("config.toml", f"a = {DEEP}", load_toml),
        ("sfm_data.json", DEEP, lambda path: peers.load(path, valid.view_model())),
    ],
)
def test_deep_nesting_is_one_line(tmp_path, name, text, read):
    (tmp_path / name).write_text(text)
    with pytest.raises((ColmapEdgesError, click.UsageError)) as caught:
        read(tmp_path / name)
    assert str(tmp_path) in str(caught.value)
    assert "\n" not in str(caught.value)
