import numpy as np
import pytest

from colmap_edges.report.charts import decades, histogram, nice_ticks, shortened
from colmap_edges.report.outcome import headline, outcome, scene_name, verdict

READ = {"images_with_poses": 24, "images_without_poses": 0, "points3D": 11878}
DETECT = {"images_without_edges": 0, "polylines": 8018, "edge_pixels": 673074}
WRITE = {"edges": 270, "edge_points": 10756, "length": 285.1007, "median_residual_px": 0.0644}
FACES = {"planar_faces": 46, "area": 82.971}
MESH = {"faces": 54309, "vertices": 27207}


def record(**counts):
    return {"stages": [{"name": name, "counts": found} for name, found in counts.items()]}


def test_outcome_of_each_command():
    whole = outcome(record(read=READ, detect=DETECT, write=WRITE, mesh=MESH))
    assert whole == {
        "Images": "24 with poses",
        "Edges": "270 in 3D, total length 285.1 scene units, median reprojection error 0.064 px",
        "Points": "11,878 SfM points and 10,756 edge points in the written model",
        "Mesh": "54,309 triangles, 27,207 vertices",
    }
    detected = outcome(record(read=READ, detect=DETECT))
    assert detected["Edges"] == "8,018 2D polylines of 673,074 pixels"
    assert "Mesh" not in detected
    assert list(outcome(record(read=READ, mesh=MESH))) == ["Images", "Points", "Mesh"]


def test_the_verdict_names_problems_and_the_next_file(tmp_path):
    stages = record(read=READ, detect=DETECT, write=WRITE)
    all_well = "24 of 24 images used, median residual 0.064 px, no problems."
    assert verdict(stages | {"findings": []}, tmp_path) == all_well
    for name in ("edges.ply", "edges.glb", "mesh.ply"):
        (tmp_path / name).touch()
    told = verdict(stages | {"findings": []}, tmp_path)
    assert told == f"{all_well} Next: open mesh.ply in MeshLab."
    read = READ | {"images_without_poses": 2}
    detect = DETECT | {"images_without_edges": 1}
    stages = record(read=read, detect=detect) | {"findings": [{}]}
    told = verdict(stages, tmp_path)
    assert told.startswith("23 of 26 images used, 1 finding below.")


def test_outcome_has_faces_if_they_were_detected():
    stages = {"read": READ, "write": WRITE, "faces": FACES, "mesh": MESH}
    faces = outcome(record(**stages))["Faces"]
    assert faces.startswith("46 planar, total area 82.97 square scene units; only in faces.json")
    used = {**stages, "faces": {**FACES, "face_points": 1}}
    assert outcome(record(**used))["Faces"].endswith("; 1 point on them added to the mesh")
    assert headline(record(**stages)) == (
        "270 3D edges, total length 285.1 scene units, 46 planar faces and a mesh of 54,309 "
        "triangles, from 24 images."
    )
    stages["faces"] = {"planar_faces": 0, "area": 0.0}
    assert outcome(record(**stages))["Faces"] == "no planar face was found"
    assert "face" not in headline(record(**stages))


def test_outcome_says_in_how_many_images_the_sky_is():
    stages = {"read": READ, "sky": {"images": 24, "images_with_sky": 0, "sky_rays": 0}}
    assert "Sky" not in outcome(record(**stages))
    stages["sky"] |= {"images_with_sky": 21, "sky_rays": 30_000}
    assert outcome(record(**stages))["Sky"] == (
        "sky or far backdrop in 21 of 24 images: its rays keep the mesh open"
    )


def test_outcome_says_whether_lenses_were_refined():
    stages = {"read": READ, "lenses": {"refined": False, "held_out_gain": 0.01}}
    assert "Lenses" not in outcome(record(**stages))
    stages["lenses"] = {"refined": True, "held_out_gain": 0.312}
    assert outcome(record(**stages))["Lenses"] == (
        "second coefficient of distortion refined: held-out SfM points fit 31% better"
    )


def test_outcome_names_missing_results():
    read = {**READ, "images_without_poses": 3}
    nothing = {"edges": 0, "edge_points": 0, "length": 0.0, "median_residual_px": None}
    detect = {**DETECT, "images_without_edges": 2}
    said = outcome(
        record(read=read, detect=detect, write=nothing, mesh={"faces": 0, "vertices": 0})
    )
    assert said["Images"] == "24 with poses, 3 without (not used), 2 in which no edge was detected"
    assert said["Edges"] == "no 3D edge was found"
    assert said["Mesh"] == "empty"


def test_single_things_are_in_the_singular():
    write = {**WRITE, "edges": 1, "edge_points": 1}
    stages = {"read": READ, "write": write, "faces": {"planar_faces": 1, "area": 1.0}}
    assert headline(record(**stages, mesh={"faces": 1, "vertices": 1})) == (
        "1 3D edge, total length 285.1 scene units, 1 planar face and a mesh of 1 triangle, "
        "from 24 images."
    )
    assert outcome(record(**stages))["Points"].endswith("and 1 edge point in the written model")


def test_headline():
    assert headline(record(read=READ, write=WRITE, mesh=MESH)) == (
        "270 3D edges, total length 285.1 scene units and a mesh of 54,309 triangles, "
        "from 24 images."
    )
    assert headline(record(read=READ, mesh=MESH)).startswith("A mesh of 54,309 triangles")


@pytest.mark.parametrize(
    ("image_path", "name"),
    [
        ("/data/fountain/images", "fountain"),
        ("/data/castle/dense/0/images", "castle"),
        ("/home/me/kitchen", "kitchen"),
        ("/images", "scene"),
    ],
)
def test_scene_is_named_by_its_folder(image_path, name):
    assert scene_name({"image_path": image_path, "input_path": "/sparse/0"}) == name


def test_ticks_are_round_and_few():
    assert nice_ticks(0, 23000) == [0, 5000, 10000, 15000, 20000]
    assert nice_ticks(2.5, 24.5) == [5, 10, 15, 20]
    assert decades(-1.2, 1.1) == [0.1, 1, 10]
    assert decades(-0.9, 0.9) == [0.2, 0.5, 1, 2, 5]
    assert [shortened(v) for v in (0.25, 20000, 3e6)] == ["0.25", "20,000", "3 M"]


def test_bars_are_as_high_as_their_counts():
    chart = histogram("T", "x", "things", np.array([0.5, 0.5, 1.5]), np.array([0.0, 1, 2]))
    heights = [bar[3] for bar in chart["bars"]]
    assert heights[0] == pytest.approx(2 * heights[1], abs=0.2)
    assert chart["bars"][0][4] == "0 to 1: 2 things"
