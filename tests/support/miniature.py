"""A miniature of the DTU data: a textured table with a raised square on it, in millimetres."""

import cv2
import numpy as np
from scipy.io import savemat

CALIBRATION = np.array([(420.0, 0, 160), (0, 420, 120), (0, 0, 1)])
SIZE = (320, 240)
HEIGHT = 8.0  # of the square of side 24 in the middle, above the table z = 0


def poses(count=6):
    """Rotations and translations of cameras 100 mm above the table, on an arc."""
    result = []
    for angle in np.linspace(-0.35, 0.35, count):
        center = np.array([100 * np.sin(angle), 12 * np.cos(5 * angle), 100 * np.cos(angle)])
        z = -center / np.linalg.norm(center)
        x = np.cross([0, 1.0, 0], z)
        x /= np.linalg.norm(x)
        rotation = np.array([-x, -np.cross(z, x), z])
        result.append((rotation, -rotation @ center))
    return result


def render(rotation, translation, textures):
    """Picture of both planes; the raised one hides the other."""
    picture = np.zeros((SIZE[1], SIZE[0]), dtype=np.uint8)
    for texture, half, z in ((textures[0], 60, 0.0), (textures[1], 12, HEIGHT)):
        scale = 2 * half / texture.shape[0]  # texture pixel (u, v) lies at (u, v) scale - half
        plane = np.array([(scale, 0, -half), (0, scale, -half), (0, 0, z), (0, 0, 1)])
        homography = CALIBRATION @ np.column_stack([rotation, translation]) @ plane
        # OpenCV's pixel centres are whole numbers, the calibration's are halves.
        shift = np.array([(1, 0, -0.5), (0, 1, -0.5), (0, 0, 1)])
        warped = cv2.warpPerspective(texture, shift @ homography, SIZE, flags=cv2.INTER_AREA)
        inside = cv2.warpPerspective(np.full_like(texture, 255), shift @ homography, SIZE)
        picture = np.where(inside > 127, warped, picture)
    return picture


def surface_points(spacing=0.5):
    """Points on the table and on the top of the square."""
    table = np.arange(-40, 40 + spacing / 2, spacing)
    x, y = np.meshgrid(table, table)
    raised = (np.abs(x) <= 12) & (np.abs(y) <= 12)
    return np.column_stack([x.ravel(), y.ravel(), np.where(raised, HEIGHT, 0.0).ravel()])


def write(root, scan=6, cameras=6):
    """Write the official layout below `root`."""
    generator = np.random.default_rng(3)
    noise = [cv2.GaussianBlur(generator.uniform(0, 255, (n, n)), (0, 0), 2.5) for n in (900, 400)]
    textures = [cv2.normalize(t, None, 60, 190, cv2.NORM_MINMAX).astype(np.uint8) for t in noise]
    for texture in textures:  # frames and a disc, so that there are edges to trace
        size = texture.shape[0]
        cv2.rectangle(texture, (size // 5, size // 5), (size * 4 // 5, size * 4 // 5), 255, 12)
        cv2.circle(texture, (size // 3, size // 2), size // 9, 0, -1)
    sample = root / "SampleSet" / "MVS Data"
    images, calibration = root / "Rectified" / f"scan{scan}", sample / "Calibration" / "cal18"
    for folder in (images, calibration, sample / "Points" / "stl", sample / "ObsMask"):
        folder.mkdir(parents=True)
    for position, (rotation, translation) in enumerate(poses(cameras), start=1):
        picture = render(rotation, translation, textures)
        for light in ("max", "3_r5000"):
            cv2.imwrite(str(images / f"rect_{position:03d}_{light}.png"), picture)
        projection = CALIBRATION @ np.column_stack([rotation, translation])
        np.savetxt(calibration / f"pos_{position:03d}.txt", 1.7 * projection)
    write_points(sample / "Points" / "stl" / f"stl{scan:03d}_total.ply", surface_points())
    resolution = 2.0
    mask = np.ones((41, 41, 11), dtype=np.uint8)
    mask[:5] = 0  # nobody sees x < -31
    box = np.array([(-40.0, -40, -5), (40, 40, 15)])
    mask_path = sample / "ObsMask" / f"ObsMask{scan}_10.mat"
    savemat(mask_path, {"ObsMask": mask, "BB": box, "Res": resolution, "Margin": 10})
    savemat(sample / "ObsMask" / f"Plane{scan}.mat", {"P": np.array([[0, 0, 1.0, -0.1]]).T})
    return root


def write_mvsnet(root, scan=6, cameras=6):
    """Write the crops of MVSNet's layout below `root`, with depth maps of a quarter of their size.

    The left quarter of the depth maps is marked as background.
    """
    official = write(root / "official", scan, cameras)
    images, depths = root / "Rectified" / f"scan{scan}_train", root / "Depths" / f"scan{scan}_train"
    train = root / "Cameras" / "train"
    for folder in (images, depths, train):
        folder.mkdir(parents=True)
    to_camera = np.diag([0.25, 0.25, 1])
    for index, (rotation, translation) in enumerate(poses(cameras)):
        name = f"rect_{index + 1:03d}_3_r5000.png"
        (official / "Rectified" / f"scan{scan}" / name).rename(images / name)
        pose = np.eye(4)
        pose[:3] = np.column_stack([rotation, translation])
        for folder, calibration in ((train, to_camera @ CALIBRATION), (train.parent, CALIBRATION)):
            rows = [" ".join(map(repr, map(float, row))) for row in (*pose, *calibration)]
            text = ["extrinsic", *rows[:4], "", "intrinsic", *rows[4:], "", "425.0 2.5"]
            (folder / f"{index:08d}_cam.txt").write_text("\n".join(text) + "\n")
        depth = true_depth(rotation, translation, to_camera @ CALIBRATION)
        content = b"Pf\n%d %d\n-1.000000\n" % depth.shape[::-1] + depth[::-1].tobytes()
        (depths / f"depth_map_{index:04d}.pfm").write_bytes(content)
        visual = np.full(depth.shape, 200, dtype=np.uint8)
        visual[:, : depth.shape[1] // 4] = 0
        cv2.imwrite(str(depths / f"depth_visual_{index:04d}.png"), visual)
    return root


def true_depth(rotation, translation, calibration):
    """Depth (60, 80) of both planes at the centres of the pixels of `calibration`."""
    rows, columns = np.indices((SIZE[1] // 4, SIZE[0] // 4)) + 0.5
    rays = np.stack([columns, rows, np.ones_like(rows)], axis=-1) @ np.linalg.inv(calibration).T
    directions, center = rays @ rotation, -rotation.T @ translation
    top = (HEIGHT - center[2]) / directions[..., 2]
    on_top = (np.abs(center + top[..., None] * directions)[..., :2] <= 12).all(axis=-1)
    return np.where(on_top, top, -center[2] / directions[..., 2]).astype("<f4")


def write_points(path, points):
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n"
        "property float x\nproperty float y\nproperty float z\nend_header\n"
    )
    path.write_bytes(header.encode() + np.asarray(points, "<f4").tobytes())
