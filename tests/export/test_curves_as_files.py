"""Curves as files of CAD programs, opened again by such programs' own libraries."""

import json
import re
import xml.etree.ElementTree as ElementTree
from dataclasses import fields, replace

import ezdxf
import numpy as np
import pytest
from curve_edges import one_of_each_kind
from ezdxf.math import OCS

from colmap_edges.core.curves3d import KINDS, Curves3D
from colmap_edges.core.observations import Observations
from colmap_edges.edges3d.curves.fitting import fit_curves
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.export.curve_records import curve_records, curves_of_records
from colmap_edges.export.dxf import write_dxf, write_dxf_polylines
from colmap_edges.export.limap import read_limap2, write_structures
from colmap_edges.export.svg import write_svg


@pytest.fixture(scope="module")
def edges():
    """A line, an arc, a circle, an elliptic arc, an ellipse and a spline, in this order."""
    return one_of_each_kind()


@pytest.fixture(scope="module")
def curves(edges):
    found = fit_curves(edges)
    assert [KINDS[kind] for kind in found.kinds] == list(KINDS)
    return found


def dxf_ends(entity):
    """Start and end of an entity of ezdxf, in the world."""
    kind = entity.dxftype()
    if kind == "LINE":
        return [entity.dxf.start, entity.dxf.end]
    if kind == "SPLINE":
        return [entity.control_points[0], entity.control_points[-1]]
    if kind == "CIRCLE":
        plane = OCS(entity.dxf.extrusion)
        return list(plane.points_to_wcs(entity.vertices([0, 180])))
    return [entity.start_point, entity.end_point]


def test_ezdxf_reads_kinds_places_and_radii(curves, tmp_path):
    write_dxf(curves, tmp_path / "edges.dxf")
    drawing = ezdxf.readfile(tmp_path / "edges.dxf")
    assert not drawing.audit().errors and not drawing.audit().fixes
    entities = list(drawing.modelspace())
    wanted = ["LINE", "ARC", "CIRCLE", "ELLIPSE", "ELLIPSE", "SPLINE"]
    assert [entity.dxftype() for entity in entities] == wanted
    assert [entity.dxf.layer for entity in entities] == [kind.upper() for kind in KINDS]
    ends = curves.ends()
    for curve in (0, 1, 3, 5):
        found = np.array([tuple(point) for point in dxf_ends(entities[curve])])
        np.testing.assert_allclose(found, ends[curve], atol=1e-9)
    for curve in (1, 2):
        assert entities[curve].dxf.radius == pytest.approx(curves.radii[curve, 0], rel=1e-12)
        plane = OCS(entities[curve].dxf.extrusion)
        center = tuple(plane.to_wcs(entities[curve].dxf.center))
        np.testing.assert_allclose(center, curves.frames[curve, 0], atol=1e-9)
    for curve in (3, 4):
        ellipse = entities[curve].dxf
        np.testing.assert_allclose(tuple(ellipse.major_axis), curves.frames[curve, 1], atol=1e-12)
        ratio = curves.radii[curve, 1] / curves.radii[curve, 0]
        assert ellipse.ratio == pytest.approx(ratio, rel=1e-12)
    spline = entities[5].construction_tool()
    middle = np.array([0.0, 0.3, 0.7, 1.0])
    found = [tuple(spline.point(t)) for t in middle * curves.spans[5, 1]]
    np.testing.assert_allclose(found, curves.at(np.full(4, 5), middle), atol=1e-9)


def test_dxf_has_extents_units_and_numbers_of_edges(curves, edges, tmp_path):
    moved = replace(curves, edges=curves.edges + 40)
    write_dxf(moved, tmp_path / "edges.dxf", unit="mm")
    drawing = ezdxf.readfile(tmp_path / "edges.dxf")
    assert drawing.header["$INSUNITS"] == 4 and drawing.header["$MEASUREMENT"] == 1
    points = curves.sampled_evenly(500)[0]
    extents = [drawing.header["$EXTMIN"], drawing.header["$EXTMAX"]]
    np.testing.assert_allclose(extents, [points.min(axis=0), points.max(axis=0)], atol=1e-3)
    view = drawing.viewports.get("*Active")[0].dxf
    assert view.height >= np.ptp(points[:, 1])
    tags = [entity.get_xdata("COLMAP_EDGES") for entity in drawing.modelspace()]
    assert [(text.value, number.value) for text, number in tags] == [
        (f"edge {40 + edge}", 40 + edge) for edge in curves.edges.tolist()
    ]
    write_dxf_polylines(edges, tmp_path / "lines.dxf", unit="ft")
    drawing = ezdxf.readfile(tmp_path / "lines.dxf")
    assert not drawing.audit().errors and drawing.header["$MEASUREMENT"] == 0
    lines = list(drawing.modelspace())
    assert [line.is_3d_polyline for line in lines] == 6 * [True]
    assert [line.is_closed for line in lines] == edges.closed.tolist()
    vertices = np.concatenate([[tuple(point) for point in line.points()] for line in lines])
    np.testing.assert_allclose(vertices, edges.points)


def test_the_same_curves_give_the_same_file(curves, tmp_path):
    write_dxf(curves, tmp_path / "one.dxf")
    write_dxf(curves, tmp_path / "other.dxf")
    assert (tmp_path / "one.dxf").read_bytes() == (tmp_path / "other.dxf").read_bytes()
    write_dxf(Curves3D.none(), tmp_path / "none.dxf")
    assert len(ezdxf.readfile(tmp_path / "none.dxf").modelspace()) == 0


def test_handles_of_a_dxf_are_unique_and_below_the_next_one(curves, tmp_path):
    write_dxf(curves, tmp_path / "edges.dxf")
    lines = (tmp_path / "edges.dxf").read_text().split("\n")
    tags = list(zip(map(int, lines[:-1:2]), lines[1::2], strict=True))
    following = int(tags[tags.index((9, "$HANDSEED")) + 1][1], 16)
    body = tags[tags.index((2, "TABLES")) :]  # codes of the header's values have other meanings
    handles = [int(value, 16) for code, value in body if code in (5, 105)]
    assert len(handles) > curves.num_curves
    assert len(set(handles)) == len(handles) and max(handles) < following


@pytest.mark.parametrize(("scale", "offset"), [(1e-9, 0.0), (1e7, 0.0), (1.0, 4.5e6)])
def test_dxf_keeps_points_at_any_scale(curves, tmp_path, scale, offset):
    frames = curves.frames * scale
    frames[:, 0] += offset
    moved = replace(curves, frames=frames, control_points=curves.control_points * scale + offset)
    write_dxf(moved, tmp_path / "edges.dxf")
    line, *_, spline = ezdxf.readfile(tmp_path / "edges.dxf").modelspace()
    found = np.array([tuple(point) for point in dxf_ends(line) + dxf_ends(spline)])
    np.testing.assert_allclose(found, moved.ends()[[0, 5]].reshape(4, 3), rtol=1e-11)


def step_curves(path):
    """The curves of a STEP file, as OpenCASCADE reads them."""
    from OCP import TopoDS
    from OCP.BRepAdaptor import BRepAdaptor_Curve
    from OCP.STEPControl import STEPControl_Reader
    from OCP.TopAbs import TopAbs_ShapeEnum
    from OCP.TopExp import TopExp_Explorer

    reader = STEPControl_Reader()
    reader.ReadFile(str(path))
    reader.TransferRoots()
    explorer = TopExp_Explorer(reader.OneShape(), TopAbs_ShapeEnum.TopAbs_EDGE)
    found = []
    while explorer.More():
        found.append(BRepAdaptor_Curve(TopoDS.TopoDS.Edge(explorer.Current())))
        explorer.Next()
    return found


def test_the_cad_kernel_reads_kinds_and_radii(curves, tmp_path):
    pytest.importorskip("OCP", reason="STEP files are written by OpenCASCADE (extra step)")
    from colmap_edges.export.step import write_step

    written = write_step(curves, tmp_path / "edges.step")
    assert (written.num_curves, written.unit_mm) == (6, 1)
    first = (tmp_path / "edges.step").read_bytes()
    text = first.decode().replace("\n", "")
    names = re.findall(r"GEOMETRIC_CURVE_SET\('([^']*)'", text)
    assert names == [f"edge {edge}" for edge in curves.edges.tolist()]
    layers = re.findall(r"PRESENTATION_LAYER_ASSIGNMENT\('([^']*)'", text)
    assert sorted(layers) == sorted(kind.upper() for kind in KINDS)
    assert write_step(curves, tmp_path / "cm.step", unit="cm").unit_mm == 10
    radius = step_curves(tmp_path / "cm.step")[1].Circle().Radius()
    assert radius == pytest.approx(10 * curves.radii[1, 0], rel=1e-9)
    write_step(curves, tmp_path / "edges.step")
    assert (tmp_path / "edges.step").read_bytes() == first
    found = step_curves(tmp_path / "edges.step")
    names = [curve.GetType().name.removeprefix("GeomAbs_") for curve in found]
    assert names == ["Line", "Circle", "Circle", "Ellipse", "Ellipse", "BSplineCurve"]
    for row in (1, 2):
        assert found[row].Circle().Radius() == pytest.approx(curves.radii[row, 0], rel=1e-9)
    for row in (3, 4):
        axes = found[row].Ellipse().MajorRadius(), found[row].Ellipse().MinorRadius()
        assert axes == pytest.approx(tuple(curves.radii[row]), rel=1e-9)
    for row in (0, 1, 3, 5):
        places = found[row].FirstParameter(), found[row].LastParameter()
        points = [found[row].Value(place) for place in places]
        ends = [(point.X(), point.Y(), point.Z()) for point in points]
        np.testing.assert_allclose(ends, curves.ends()[row], atol=1e-7)


@pytest.mark.parametrize("scale", [1e-5, 1e-9, 1e6])
def test_the_cad_kernel_reads_curves_of_scenes_in_any_unit(curves, tmp_path, scale):
    pytest.importorskip("OCP", reason="STEP files are written by OpenCASCADE (extra step)")
    from colmap_edges.export.step import write_step

    frames = curves.frames * scale
    frames[0, 1] = 0  # a line without length
    scaled = replace(curves, frames=frames, control_points=curves.control_points * scale)
    written = write_step(scaled, tmp_path / "edges.step")
    found = step_curves(tmp_path / "edges.step")
    assert written.num_curves == len(found) == 5
    wanted = scaled.radii[1, 0] * written.unit_mm
    assert found[0].Circle().Radius() == pytest.approx(wanted, rel=1e-9)
    shortest = scaled.lengths()[1:].min() * written.unit_mm
    assert shortest >= 1e-5
    assert written.unit_mm == 1 or shortest < 1e-4  # no larger than needed


def test_step_without_the_kernel_says_what_to_install(curves, tmp_path, monkeypatch):
    from colmap_edges.export.step import write_step

    monkeypatch.setitem(__import__("sys").modules, "OCP", None)
    with pytest.raises(ColmapEdgesError, match=r"pip install 'colmap-edges\[step\]'"):
        write_step(curves, tmp_path / "edges.step")
    assert not (tmp_path / "edges.step").exists()


def test_records_give_the_curves_back(edges, curves):
    records = json.loads(json.dumps(curve_records(curves, edges.edge_offsets)))
    assert [record["kind"] for record in records] == list(KINDS)
    assert records[2]["radii"] == pytest.approx([0.4, 0.4], rel=0.01)
    back = curves_of_records(records, edges.edge_offsets)
    for entry in fields(Curves3D):
        given, found = getattr(curves, entry.name), getattr(back, entry.name)
        np.testing.assert_allclose(found, given, rtol=1e-5, atol=1e-12, err_msg=entry.name)
    with pytest.raises(ValueError, match="edge 9"):
        curves_of_records([records[0] | {"edge": 9}], edges.edge_offsets)
    with pytest.raises(ValueError, match="four knots more"):
        curves_of_records([records[5] | {"knots": [0, 1]}], edges.edge_offsets)


def test_svg_shows_what_a_view_sees(scene_model, scene_edges, tmp_path):
    curves = fit_curves(scene_edges)
    view = scene_model.views[0]
    write_svg(scene_edges, curves, view, 0, tmp_path / "view.svg")
    root = ElementTree.parse(tmp_path / "view.svg").getroot()
    name = "{http://www.w3.org/2000/svg}"
    assert (int(root.get("width")), int(root.get("height"))) == (view.width, view.height)
    groups = {group.get("class"): group for group in root.findall(f"{name}g")}
    assert list(groups) == list(KINDS)
    solid, hidden = [], []
    for path in root.iter(f"{name}path"):
        points = [pair.split(",") for pair in path.get("d").split()[1:]]
        (hidden if path.get("class") == "hidden" else solid).append(np.array(points, float))
    drawn = np.concatenate(solid)
    observed = scene_edges.observations.pixels[scene_edges.observations.views == 0]
    near = np.linalg.norm(observed[:, None] - drawn, axis=2).min(axis=1)
    assert np.mean(near < 4) > 0.95  # steps along curves are some pixels
    unseen = replace(
        scene_edges, observations=scene_edges.observations.keep(scene_edges.observations.views != 0)
    )
    write_svg(unseen, curves, view, 0, tmp_path / "unseen.svg")
    root = ElementTree.parse(tmp_path / "unseen.svg").getroot()
    assert {path.get("class") for path in root.iter(f"{name}path")} == {"hidden"}


def test_svg_is_xml_whatever_the_image_is_called(scene_model, scene_edges, tmp_path):
    name = 'a\x01\x1b\x00<&>"\n\udcff\uffff.jpg'  # of bytes that are no text, too
    view = replace(scene_model.views[0], name=name)
    write_svg(scene_edges, fit_curves(scene_edges), view, 0, tmp_path / "view.svg")
    root = ElementTree.parse(tmp_path / "view.svg").getroot()
    wanted = r"a\x01\x1b\x00<&>" + '"' + r"\n\udcff\uffff.jpg"
    assert root.findtext("{http://www.w3.org/2000/svg}title") == wanted


def test_a_folder_of_lines_replaces_its_like_alone(scene_model, scene_edges, tmp_path):
    curves, folder = fit_curves(scene_edges), tmp_path / "structures"
    write_structures(scene_edges, curves, scene_model, folder)
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    with pytest.raises(ColmapEdgesError, match="exists already"):
        write_structures(scene_edges, curves, scene_model, folder)
    write_structures(scene_edges, curves, scene_model, folder, overwrite=True)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    (folder / "lines3D.bin").write_bytes(b"of another program")
    with pytest.raises(ColmapEdgesError, match="was changed since"):
        write_structures(scene_edges, curves, scene_model, folder, overwrite=True)
    assert (folder / "lines3D.bin").read_bytes() == b"of another program"


def test_limap_reader_gets_lines_with_their_segments(scene_model, scene_edges, tmp_path):
    curves = fit_curves(scene_edges)
    count = write_structures(scene_edges, curves, scene_model, tmp_path / "structures")
    lines = read_limap2(tmp_path / "structures")
    assert len(lines) == count > 0
    names = {path.name for path in (tmp_path / "structures").iterdir()}
    wanted = {"lines3D.bin", "structures2d.bin", "groups3D.bin", "wireframe3D.bin"}
    assert names == wanted | {"colmap-edges.json"}  # without one of them LIMAP reads none
    views = {view.image_id: view for view in scene_model.views}
    for line in lines:
        assert len(line.image_ids) == len(line.ends2D) >= 2
        for image_id, ends in zip(line.image_ids.tolist(), line.ends2D, strict=True):
            pixels, _ = views[image_id].project(line.segments[0])
            way = (pixels[1] - pixels[0]) / np.linalg.norm(pixels[1] - pixels[0])
            off = (ends - pixels[0]) @ (-way[1], way[0])
            assert np.abs(off).max() < 4  # chords of arcs of 10 degrees, and noise


def test_an_edge_no_two_views_observe_is_no_line_of_limap(edges, curves, scene_model, tmp_path):
    assert write_structures(edges, curves, scene_model, tmp_path / "structures") == 0
    assert read_limap2(tmp_path / "structures") == []
    assert isinstance(edges.observations, Observations)
